//! A COLMAP text model (cameras.txt, images.txt; colmap.github.io/format.html): lenses and poses of every photograph.
//! COLMAP's pixel centres are at 0.5, its poses turn the world into the camera, its unit of length is arbitrary.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DQuat, DVec2, DVec3};

use super::{Found, plane};
use crate::geometry::{Lens, Pose, Surface};
use crate::session::{Manifest, View};
use crate::view_file::colmap::{data_lines, finite, read_cameras};
use crate::{Error, Result};

/// Reads the model and finds the surface: the plane on which most of its points lie.
pub(super) fn read(
    model: &Path,
    photographs: &Path,
    surface: Option<Surface>,
    notes: &mut Vec<String>,
) -> Result<(Manifest, Vec<Found>)> {
    let cameras = read_cameras(&model.join("cameras.txt"))?;
    let images_path = model.join("images.txt");
    let images = read_images(&images_path, &cameras)?;
    let mut tracks: BTreeMap<i64, Vec<plane::Ray>> = BTreeMap::new();
    for image in &images {
        for &(pixel, point) in &image.points {
            if let Some(direction) = image.lens.unproject(pixel) {
                let ray = plane::Ray {
                    origin: image.pose.centre_m,
                    direction: image.pose.direction_to_surface(direction),
                };
                tracks.entry(point).or_default().push(ray);
            }
        }
    }
    let centres: Vec<DVec3> = images.iter().map(|image| image.pose.centre_m).collect();
    let rights: Vec<DVec3> = images.iter().map(|image| image.pose.direction_to_surface(DVec3::X)).collect();
    let frame =
        plane::find(&tracks.into_values().collect::<Vec<_>>(), &centres, &rights).ok_or_else(|| {
            Error::input(
                &images_path,
                "has too few points on one plane to find the surface",
                "import a model of a flat surface",
            )
        })?;
    let area = surface.unwrap_or(frame.surface);
    notes.push(format!(
        "the surface, {:.3} x {:.3} m, is on the plane of {} of the model's {} points; one unit of the model counts as 1 m",
        area.width_m, area.height_m, frame.on_plane, frame.points
    ));
    let mut manifest = Manifest { surface: Some(area), ..Manifest::new("COLMAP model") };
    let mut found = vec![];
    for (view, image) in images.into_iter().enumerate() {
        let pose = Pose {
            camera_from_surface: image.pose.camera_from_surface * frame.world_from_surface,
            centre_m: frame.world_from_surface.inverse() * (image.pose.centre_m - frame.origin),
        };
        let lens = manifest.lenses.iter().position(|lens| *lens == image.lens).unwrap_or_else(|| {
            manifest.lenses.push(image.lens);
            manifest.lenses.len() - 1
        });
        manifest.views.push(View {
            name: format!("view{view:03}"),
            pan_deg: None,
            tilt_deg: None,
            lens,
            pose: Some(pose),
        });
        found.push(Found { path: photographs.join(&image.name), view, exposure_s: None });
    }
    Ok((manifest, found))
}

struct Image {
    name: String,
    lens: Lens,
    pose: Pose,
    points: Vec<(DVec2, i64)>,
}

fn read_images(path: &Path, cameras: &BTreeMap<u32, Lens>) -> Result<Vec<Image>> {
    let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
    let mut images = vec![];
    let mut lines = data_lines(&text);
    // Two lines an image; the second, its points, may be empty.
    while let Some((index, line)) = lines.next() {
        if line.trim().is_empty() {
            continue;
        }
        let wrong = |what: String| {
            Error::input(
                path,
                format!("line {index}: {what}"),
                "export the model again with COLMAP (as text)",
            )
        };
        let words: Vec<&str> = line.split_whitespace().collect();
        let numbers: Vec<f64> = words.iter().skip(1).take(7).filter_map(|word| finite(word)).collect();
        let (&[w, x, y, z, tx, ty, tz], Some(camera), true) =
            (&numbers[..], words.get(8).and_then(|word| word.parse::<u32>().ok()), words.len() > 9)
        else {
            return Err(wrong("is not an image with its quaternion, translation, camera and name".into()));
        };
        let lens =
            *cameras.get(&camera).ok_or_else(|| wrong(format!("camera {camera} is not in cameras.txt")))?;
        let rotation = DQuat::from_xyzw(x, y, z, w);
        if rotation.length().is_nan() || rotation.length() <= 1e-6 {
            return Err(wrong("its quaternion has no length".into()));
        }
        let camera_from_surface = rotation.normalize();
        let centre_m = -(camera_from_surface.inverse() * DVec3::new(tx, ty, tz));
        let (index, line) = lines.next().unwrap_or((index + 1, ""));
        let points = read_points(line).ok_or_else(|| {
            Error::input(
                path,
                format!("line {index}: is not a list of points, each x, y and number"),
                "export the model again with COLMAP (as text)",
            )
        })?;
        images.push(Image {
            name: words[9..].join(" "),
            lens,
            pose: Pose { camera_from_surface, centre_m },
            points,
        });
    }
    if images.is_empty() {
        return Err(Error::input(path, "has no image", "export the model again with COLMAP (as text)"));
    }
    images.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(images)
}

/// The pixels of an image's points, with the number of the point; those without a point (-1) are left out. `None` where a
/// word is no number or missing.
fn read_points(line: &str) -> Option<Vec<(DVec2, i64)>> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let points: Vec<(DVec2, i64)> = words
        .chunks(3)
        .map(|words| match words {
            [x, y, point] => Some((DVec2::new(finite(x)? - 0.5, finite(y)? - 0.5), point.parse().ok()?)),
            _ => None,
        })
        .collect::<Option<_>>()?;
    Some(points.into_iter().filter(|(_, point)| *point >= 0).collect())
}
