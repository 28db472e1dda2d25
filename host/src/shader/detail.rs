//! Where models are evaluated: once for each texel where that looks the same, else at every pixel.

use crate::fit::Model;
use crate::parameter_map::ParameterMap;

/// The radiance of two neighbouring texels, toward the camera from each one's centre and from a point between them, may differ
/// by about half of this part of a lobe's top: texels are small enough where the angle between two of them, from the camera, times
/// the root of [`sharpness`] is not larger.
pub const SMOOTH: f64 = 0.06;

/// The largest shininess of a map, or what a basis can show that is as sharp.
pub fn sharpness(map: &ParameterMap) -> f64 {
    let mut most = 1f64;
    for row in 0..map.texels.rows {
        for column in 0..map.texels.columns {
            let (model, parameters) = map.texel(column, row);
            let of = match model {
                Model::Constant => 0.0,
                Model::LogQuadratic => {
                    parameters[9..18].iter().fold(0.0, |most: f64, value| most.max(f64::from(value.abs())))
                }
                Model::Phong { .. } => {
                    parameters[3..].chunks_exact(7).fold(0.0, |most: f64, lobe| most.max(f64::from(lobe[3])))
                }
                Model::SharedPhong { .. } => f64::from(parameters[3]),
                // The narrowest lobe of degree n falls off as cos^m of m about n².
                Model::Harmonics { order, .. } => f64::from(order).powi(2),
            };
            most = most.max(of);
        }
    }
    most
}
