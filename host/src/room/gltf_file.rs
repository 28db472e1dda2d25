//! Triangles of a glTF scene. Only positions, indices and the first texture coordinates matter.

use std::path::Path;

use base64::Engine;
use glam::{DMat4, DVec2, DVec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::Mode;

use super::model::Model;
use crate::{Error, Result};

const REMEDY: &str = "export the room again as glTF 2.0 with triangles, not compressed";
/// Deeper scenes are circles.
const DEEPEST: usize = 64;

pub(super) fn read(path: &Path) -> Result<Model> {
    let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
    let refuse = |what: String| Error::input(path, format!("cannot be read as glTF ({what})"), REMEDY);
    let file = gltf::Gltf::from_slice(&bytes).map_err(|error| refuse(error.to_string()))?;
    let buffers: Vec<Vec<u8>> =
        file.buffers().map(|buffer| data(path, &file, &buffer)).collect::<Result<_>>()?;
    let mut model = Model { points_m: vec![], faces: vec![], uv: vec![], notes: vec![] };
    let scene = file.default_scene().or_else(|| file.scenes().next());
    let mut nodes: Vec<_> =
        scene.iter().flat_map(|scene| scene.nodes()).map(|node| (node, DMat4::IDENTITY, 0)).collect();
    let mut others = 0;
    while let Some((node, place, depth)) = nodes.pop() {
        let matrix = node.transform().matrix();
        let place = place * DMat4::from_cols_array_2d(&matrix.map(|column| column.map(f64::from)));
        if depth > DEEPEST {
            return Err(refuse("its nodes go in a circle".into()));
        }
        nodes.extend(node.children().map(|child| (child, place, depth + 1)));
        for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
            match primitive.mode() {
                Mode::Triangles => add(&mut model, &primitive, &place, &buffers).map_err(refuse)?,
                _ => others += 1,
            }
        }
    }
    if others > 0 {
        model.notes.push(format!("{others} parts that are points, lines, strips or fans were left out"));
    }
    Ok(model)
}

fn data(path: &Path, file: &gltf::Gltf, buffer: &gltf::Buffer) -> Result<Vec<u8>> {
    let bytes = match buffer.source() {
        gltf::buffer::Source::Bin => file.blob.clone().unwrap_or_default(),
        gltf::buffer::Source::Uri(uri) => match uri.strip_prefix("data:") {
            Some(inside) => {
                let text = inside.split_once("base64,").map_or("", |(_, text)| text);
                base64::engine::general_purpose::STANDARD.decode(text).unwrap_or_default()
            }
            None => {
                let place = path.with_file_name(uri.replace("%20", " "));
                std::fs::read(&place).map_err(Error::io("read", place))?
            }
        },
    };
    if bytes.len() < buffer.length() {
        let what = format!("has {} bytes in a buffer of {}", bytes.len(), buffer.length());
        return Err(Error::input(path, what, "give the complete file"));
    }
    Ok(bytes)
}

fn add(
    model: &mut Model,
    primitive: &gltf::Primitive,
    place: &DMat4,
    buffers: &[Vec<u8>],
) -> std::result::Result<(), String> {
    let plain = |accessor: &gltf::Accessor, dimensions, types: &[DataType]| {
        let size = accessor.size();
        let is_wide = accessor.view().is_some_and(|view| view.stride().is_none_or(|stride| stride >= size));
        let fits = accessor.dimensions() == dimensions && types.contains(&accessor.data_type());
        fits && is_wide && accessor.count() > 0 && accessor.sparse().is_none()
    };
    let positions = primitive.get(&gltf::Semantic::Positions).ok_or("a part has no positions")?;
    if !plain(&positions, Dimensions::Vec3, &[DataType::F32]) {
        return Err("a part's positions are not plain numbers".into());
    }
    let whole = [DataType::U8, DataType::U16, DataType::U32];
    if primitive.indices().is_some_and(|indices| !plain(&indices, Dimensions::Scalar, &whole)) {
        return Err("a part's indices are not plain numbers".into());
    }
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
    let outside = "a part lies outside of its buffer";
    let points: Vec<DVec3> = reader
        .read_positions()
        .ok_or(outside)?
        .map(|[x, y, z]| DVec3::new(x.into(), y.into(), z.into()))
        .collect();
    let indices: Vec<u32> = match primitive.indices() {
        Some(_) => reader.read_indices().ok_or(outside)?.into_u32().collect(),
        None => (0..points.len() as u32).collect(),
    };
    let (faces, _) = indices.as_chunks::<3>();
    if faces.iter().flatten().any(|&i| i as usize >= points.len()) {
        return Err("a face names a vertex that is not there".into());
    }
    let texture = primitive.get(&gltf::Semantic::TexCoords(0));
    if texture.is_some_and(|uv| plain(&uv, Dimensions::Vec2, &[DataType::F32]))
        && let Some(uv) = reader.read_tex_coords(0)
    {
        // glTF's v goes down.
        let uv: Vec<DVec2> = uv.into_f32().map(|[u, v]| DVec2::new(u.into(), 1.0 - f64::from(v))).collect();
        let corner = |i: u32| uv.get(i as usize).copied().unwrap_or(DVec2::NAN);
        model.uv.extend(faces.iter().map(|face| face.map(corner)));
    }
    model.add(&points, place, faces.iter().copied());
    Ok(())
}
