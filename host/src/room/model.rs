//! A room's triangles, from OBJ or glTF.

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat4, DVec2, DVec3};

use super::gltf_file;
use crate::{Error, Result};

/// Triangles in the room's frame (y up as a rule; that of the file).
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Vertices, metres.
    pub points_m: Vec<DVec3>,
    /// Three vertices of each face.
    pub faces: Vec<[u32; 3]>,
    /// The texture coordinates of each face's corners (u to the right, v up, as in OBJ); empty where not every face has them.
    pub uv: Vec<[DVec2; 3]>,
    /// What was left out of the file, and what is doubtful, a sentence each.
    pub notes: Vec<String>,
}

const REMEDY: &str = "export the room again as OBJ, glTF or GLB with triangles";

impl Model {
    /// Reads `.obj`, `.gltf` or `.glb`; lengths are taken for metres.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] where the file cannot be understood, holds no face, or a vertex that is no point.
    pub fn read(path: &Path) -> Result<Self> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let model = match extension.as_str() {
            "obj" => obj(path)?,
            "gltf" | "glb" => gltf_file::read(path)?,
            _ => return Err(Error::input(path, "is no model of a room", "give an .obj, .gltf or .glb file")),
        };
        model.checked().map_err(|error| error.about(path))
    }

    /// Makes sure that it can be used: faces without extent are left out, with a note; open edges are noted.
    ///
    /// # Errors
    /// [`Error::Request`] where no face is left, an index names no vertex, or a vertex is no point.
    pub fn checked(mut self) -> Result<Self> {
        if let Some(at) = self.points_m.iter().position(|point| !point.is_finite()) {
            return Err(Error::request(format!("vertex {at} is at {}", self.points_m[at]), REMEDY));
        }
        let count = self.points_m.len();
        if let Some(at) = self.faces.iter().position(|face| face.iter().any(|&i| i as usize >= count)) {
            let what = format!("face {at} names the vertices {:?} of {count}", self.faces[at]);
            return Err(Error::request(what, REMEDY));
        }
        if self.uv.len() != self.faces.len() || !self.uv.iter().flatten().all(|uv| uv.is_finite()) {
            self.uv.clear();
        }
        let size_m = self.size_m();
        let keeps: Vec<bool> =
            (0..self.faces.len()).map(|face| self.area_m2(face) > 1e-14 * size_m * size_m).collect();
        let lost = keeps.iter().filter(|keep| !**keep).count();
        if lost > 0 {
            let mut kept = keeps.iter();
            self.faces.retain(|_| *kept.next().unwrap_or(&false));
            let mut kept = keeps.iter();
            self.uv.retain(|_| *kept.next().unwrap_or(&false));
            self.notes.push(format!("{lost} faces without extent were left out"));
        }
        if self.faces.is_empty() {
            return Err(Error::request("the model holds no face", REMEDY));
        }
        let open = self.open_edges();
        if open > 0 {
            self.notes.push(format!("{open} edges belong to one face only: surfaces end there"));
        }
        Ok(self)
    }

    /// The three corners of a face.
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|i| self.points_m[i as usize])
    }

    /// The area of a face.
    pub fn area_m2(&self, face: usize) -> f64 {
        let [a, b, c] = self.corners(face);
        0.5 * (b - a).cross(c - a).length()
    }

    /// The unit vector out of a face's front, from which its corners are counted against the clock.
    pub fn normal(&self, face: usize) -> DVec3 {
        let [a, b, c] = self.corners(face);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// The diagonal of the box that holds all vertices.
    pub fn size_m(&self) -> f64 {
        let least = self.points_m.iter().copied().reduce(DVec3::min).unwrap_or_default();
        let most = self.points_m.iter().copied().reduce(DVec3::max).unwrap_or_default();
        least.distance(most)
    }

    /// Edges of one face alone; vertices at one place are one.
    fn open_edges(&self) -> usize {
        let step = 1e-6 * self.size_m();
        let mut places = HashMap::new();
        let welded: Vec<usize> = self
            .points_m
            .iter()
            .map(|point| {
                let next = places.len();
                *places.entry((point / step).round().to_array().map(|x| x as i64)).or_insert(next)
            })
            .collect();
        let mut edges: HashMap<(usize, usize), usize> = HashMap::new();
        for face in &self.faces {
            for k in 0..3 {
                let (a, b) = (welded[face[k] as usize], welded[face[(k + 1) % 3] as usize]);
                *edges.entry((a.min(b), a.max(b))).or_default() += 1;
            }
        }
        edges.values().filter(|&&count| count == 1).count()
    }

    /// Adds vertices and faces, counted from the first of these vertices.
    pub(super) fn add(&mut self, points: &[DVec3], place: &DMat4, faces: impl Iterator<Item = [u32; 3]>) {
        let first = self.points_m.len() as u32;
        self.points_m.extend(points.iter().map(|point| place.transform_point3(*point)));
        // A mirror turns what was counter-clockwise (glTF 2.0, 3.7.2.1).
        let is_mirrored = place.determinant() < 0.0;
        let turned = |[a, b, c]: [u32; 3]| if is_mirrored { [a, c, b] } else { [a, b, c] };
        self.faces.extend(faces.map(|face| turned(face.map(|i| first.saturating_add(i)))));
    }
}

fn obj(path: &Path) -> Result<Model> {
    let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..Default::default()
    };
    // Materials do not matter: the photographs tell the colours.
    let none = |_: &Path| Ok(Default::default());
    let (meshes, _) = tobj::load_obj_buf(&mut bytes.as_slice(), &options, none)
        .map_err(|error| Error::input(path, format!("cannot be read as OBJ ({error})"), REMEDY))?;
    let mut model = Model { points_m: vec![], faces: vec![], uv: vec![], notes: vec![] };
    for tobj::Model { mesh, .. } in &meshes {
        let points: Vec<DVec3> = mesh
            .positions
            .as_chunks()
            .0
            .iter()
            .map(|&[x, y, z]| DVec3::new(x.into(), y.into(), z.into()))
            .collect();
        let (faces, _) = mesh.indices.as_chunks();
        model.add(&points, &DMat4::IDENTITY, faces.iter().copied());
        if mesh.texcoord_indices.len() == mesh.indices.len() {
            let corner = |i: u32| {
                let at = 2 * i as usize;
                let uv = mesh.texcoords.get(at..at + 2).unwrap_or(&[f32::NAN; 2]);
                DVec2::new(uv[0].into(), uv[1].into())
            };
            let (corners, _) = mesh.texcoord_indices.as_chunks();
            model.uv.extend(corners.iter().map(|face: &[u32; 3]| face.map(corner)));
        }
    }
    Ok(model)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, text: &str) -> Result<Model> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        Model::read(&path)
    }

    #[test]
    fn polygons_become_triangles_and_relative_indices_count_backwards() {
        let model = read("a.obj", "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nf -4 -3 -2 -1\n").unwrap();
        assert_eq!(model.faces.len(), 2);
        assert!((0..2).all(|face| model.normal(face) == DVec3::Z && model.area_m2(face) == 1.0));
        assert!(model.notes[0].contains("4 edges"), "{:?}", model.notes);
    }

    #[test]
    fn what_is_no_room_is_refused_in_a_sentence() {
        for (name, text, part) in [
            ("a.obj", "", "no face"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\n", "no face"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no face"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv nan 0 0\nf 1 2 3\n", "vertex 2"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 7\n", "OBJ"),
            ("a.obj", "f 1 2\x00", "OBJ"),
            ("a.gltf", "{", "glTF"),
            ("a.gltf", r#"{"asset":{"version":"2.0"}}"#, "no face"),
            ("a.ply", "ply", ".glb"),
        ] {
            let message = read(name, text).map(|_| ()).unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("; "), "{text:?}: {message}");
        }
    }

    #[test]
    fn a_gltf_file_with_its_buffer_inside_is_read_with_the_nodes_places() {
        use base64::Engine;
        let numbers = [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let data = base64::engine::general_purpose::STANDARD.encode(bytes);
        let text = |count: u32| {
            format!(
                r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0,"translation":[0,0,5]}}],
                "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
                "buffers":[{{"byteLength":36,"uri":"data:application/octet-stream;base64,{data}"}}],
                "bufferViews":[{{"buffer":0,"byteLength":36}}],
                "accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}]}}"#
            )
        };
        let model = read("a.gltf", &text(3)).unwrap();
        assert_eq!(
            model.corners(0),
            [DVec3::new(0.0, 0.0, 5.0), DVec3::new(1.0, 0.0, 5.0), DVec3::new(0.0, 1.0, 5.0)]
        );
        let message = read("a.gltf", &text(300)).unwrap_err().to_string();
        assert!(message.contains("a.gltf"), "{message}");
    }
}
