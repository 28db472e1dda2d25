//! A photographed view beside what a map says of it, exposed alike: what one flips between.

use glam::DVec2;
use rigel::Result;
use rigel::evaluate::Reference;
use rigel::geometry::Texels;
use rigel::parameter_map::ParameterMap;
use rigel::progress::Silent;
use rigel::render::render;
use rigel::shader::{Look, false_colour};

/// A difference of so many levels of 255 is at the end of the scale of colours.
pub(crate) const MOST: f32 = 32.0;

/// Places along each side of the surface at which an unknown gain is measured.
const PLACES: u32 = 48;

/// Brings a photograph whose exposure time is not known to the scale of the map: by the median of their ratio over the surface.
pub fn matched(mut reference: Reference, map: &ParameterMap) -> Reference {
    if reference.exposure_time_known {
        return reference;
    }
    let places = Texels { columns: PLACES, rows: PLACES };
    let ratios = |i: u32| {
        let point_m = map.surface.texel_centre(places, i % PLACES, i / PLACES);
        let pixel = reference.lens.project(reference.pose.to_camera(point_m))?.round();
        let is_inside = pixel.cmpge(DVec2::ZERO).all()
            && pixel.x < f64::from(reference.lens.width)
            && pixel.y < f64::from(reference.lens.height);
        let index = is_inside
            .then(|| pixel.y as usize * reference.lens.width as usize + pixel.x as usize)
            .filter(|&index| reference.radiance.mask[index] == 0)?;
        let direction = (reference.pose.centre_m - point_m).normalize().as_vec3();
        let said = map.radiance_at(map.surface.texel_at(map.texels, point_m), direction);
        let seen = reference.radiance.radiance[index];
        Some((0..3).map(move |c| said[c] / seen[c].max(1e-9)))
    };
    let mut ratios: Vec<f32> = (0..PLACES * PLACES).filter_map(ratios).flatten().collect();
    if !ratios.is_empty() {
        let middle = ratios.len() / 2;
        let gain = *ratios.select_nth_unstable_by(middle, f32::total_cmp).1;
        reference.radiance.radiance.iter_mut().flatten().for_each(|value| *value *= gain);
    }
    reference
}

/// The photograph as the map would be shown.
pub fn photograph(reference: &Reference, look: &Look) -> Vec<[u8; 3]> {
    reference.radiance.radiance.iter().map(|radiance| look.levels(*radiance)).collect()
}

/// What the reconstruction (exposed, no false colours) differs from the photograph by: four times, around middle grey; or how much
/// of 255, as a colour on a scale up to [`MOST`]. Pixels that were not measured, or do not show the map's surface, are black.
///
/// # Errors
/// As [`shows`].
pub fn difference(
    map: &ParameterMap,
    reference: &Reference,
    reconstruction: &[[u8; 3]],
    look: &Look,
) -> Result<Vec<[u8; 3]>> {
    let exposed = photograph(reference, &Look { false_colour: false, ..*look });
    let pairs = exposed.iter().zip(reconstruction).zip(shows(map, reference)?);
    Ok(pairs
        .map(|((photograph, reconstruction), is_known)| {
            let off = |c: usize| i32::from(reconstruction[c]) - i32::from(photograph[c]);
            match (is_known, look.false_colour) {
                (true, false) => std::array::from_fn(|c| (128 + 4 * off(c)).clamp(0, 255) as u8),
                (true, true) => apart(photograph, reconstruction),
                _ => [0; 3],
            }
        })
        .collect())
}

/// For each pixel of a photograph, whether it was measured and shows the map's surface.
///
/// # Errors
/// [`rigel::Error::Request`] when the camera does not stand above the surface.
pub(crate) fn shows(map: &ParameterMap, reference: &Reference) -> Result<Vec<bool>> {
    let nothing = |_, _| [0.0; 3];
    let seen = render(&map.surface, &reference.lens, &reference.pose, nothing, &Silent)?;
    let measured = reference.radiance.mask.iter().map(|mask| *mask == 0);
    Ok(seen.inside.iter().zip(measured).map(|(inside, measured)| *inside && measured).collect())
}

/// How far two exposed colours are apart, as a colour on a scale up to [`MOST`].
pub(crate) fn apart(a: &[u8; 3], b: &[u8; 3]) -> [u8; 3] {
    let sum: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
    false_colour((sum as f32 / 3.0 / MOST).min(1.0))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use rigel::fit::Model;
    use rigel::geometry::{Lens, Pose, Surface};
    use rigel::radiance::RadianceImage;

    /// An even map.
    pub(crate) fn map(radiance: [f32; 3]) -> ParameterMap {
        let texels = Texels { columns: 16, rows: 12 };
        ParameterMap {
            surface: Surface { width_m: 0.2, height_m: 0.15 },
            texels,
            models: vec![Model::Constant],
            choice: vec![],
            parameters: radiance.repeat(texels.count()),
            diagnostics: None,
            uncertainty: None,
        }
    }

    /// An even photograph from straight above, which shows more than the surface.
    pub(crate) fn reference(radiance: [f32; 3]) -> Reference {
        let (width, height) = (160, 100);
        let count = (width * height) as usize;
        Reference {
            name: "view".into(),
            lens: Lens::pinhole(width, height, 170.0),
            pose: Pose::from_rig(0.0, 0.0, 0.5),
            radiance: RadianceImage {
                width,
                height,
                radiance: vec![radiance; count],
                variance: vec![[0.0; 3]; count],
                mask: vec![0; count],
            },
            exposure_time_known: true,
        }
    }

    #[test]
    fn black_is_compared_and_what_is_not_the_surface_or_not_measured_is_not() {
        let (map, mut reference) = (map([0.0; 3]), reference([0.05; 3]));
        let (width, middle) = (160, 50 * 160 + 80);
        reference.radiance.mask[middle + 4] = 1;
        let look = Look { gamma: 1.0, false_colour: false, beside: [0.0; 3] };
        let black = vec![[0; 3]; reference.radiance.mask.len()];
        let shown = difference(&map, &reference, &black, &look).unwrap();
        // The photograph is brighter: below middle grey.
        assert!((1..128).contains(&shown[middle][0]), "{:?}", shown[middle]);
        for beside in [0, width - 1, middle + 4] {
            assert_eq!(shown[beside], [0; 3], "{beside}");
        }
    }
}
