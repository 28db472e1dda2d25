//! What the overlapping views tell of the light, as a file: `photometry.toml`. The lamp's gain in each view, and the lens's fall-off where
//! no flat fields tell it.

use std::path::PathBuf;

use glam::DVec2;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::Vignetting;
use super::registration::{self, Registration};
use crate::radiance::RadianceImage;
use crate::session::Session;
use crate::{Error, Result, file};

const NAME: &str = "photometry.toml";
const FORMAT: u32 = 1;
const AGAIN: &str = "run `rigel observe` again, or remove the file to take the radiance as it was measured";

/// By what a session's radiance is divided, so that all of it is on one scale.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Photometry {
    /// Version of the file.
    pub format: u32,
    /// Tells the radiance, poses and angles from which it was made.
    pub made_from: String,
    /// What was found, and what was left as it is, one sentence each.
    #[serde(default)]
    pub notes: Vec<String>,
    /// The fall-off towards the corners, where the views told it and no flat fields did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vignetting: Option<Vignetting>,
    /// The lamp in each view, where it was not steady.
    #[serde(rename = "view", default, skip_serializing_if = "Vec::is_empty")]
    pub views: Vec<ViewGain>,
}

/// How bright the lamp was in one view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewGain {
    /// The view's name in the session.
    pub name: String,
    /// The lamp's radiance over its geometric mean, red, green and blue.
    pub gain: [f64; 3],
    /// Its standard deviation, relative.
    pub sigma: [f64; 3],
}

impl Photometry {
    /// Nothing found as yet, of a session as it is now.
    ///
    /// # Errors
    /// [`Error::Input`] where the session has no radiance; [`Error::Io`].
    pub(crate) fn nothing(session: &Session) -> Result<Self> {
        let made_from = made_from(session)?;
        Ok(Self { format: FORMAT, made_from, notes: vec![], vignetting: None, views: vec![] })
    }

    /// Where a session keeps it.
    pub fn path(session: &Session) -> PathBuf {
        session.folder().join(NAME)
    }

    /// Writes the session's photometry.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be written; what stood there before then stays.
    pub fn write(&self, session: &Session) -> Result<()> {
        let text = toml::to_string(self).expect("photometry is plain data");
        file::write_bytes(&Self::path(session), text.as_bytes())
    }

    /// The session's photometry; `None` where it has none.
    ///
    /// # Errors
    /// [`Error::Input`] where it is damaged or was made from other radiance or poses; [`Error::Io`].
    pub fn of(session: &Session) -> Result<Option<Self>> {
        let path = Self::path(session);
        if !path.exists() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&path).map_err(Error::io("read", &path))?;
        let photometry: Self = toml::from_str(&text)
            .map_err(|error| Error::input(&path, format!("is damaged ({})", error.message()), AGAIN))?;
        if photometry.format != FORMAT {
            let what = format!("has format {}, this reads format {FORMAT}", photometry.format);
            return Err(Error::input(&path, what, AGAIN));
        }
        let is_sound = |view: &ViewGain| {
            view.gain.iter().all(|gain| gain.is_finite() && *gain > 0.0)
                && view.sigma.iter().all(|sigma| sigma.is_finite() && *sigma >= 0.0)
        };
        if let Some(view) = photometry.views.iter().find(|view| !is_sound(view)) {
            let what = format!("has for {} a gain or sigma that cannot be", view.name);
            return Err(Error::input(&path, what, AGAIN));
        }
        if photometry.vignetting.is_some_and(|vignetting| !vignetting.is_finite()) {
            return Err(Error::input(&path, "has a vignetting that is not a number", AGAIN));
        }
        if photometry.made_from != made_from(session)? {
            return Err(Error::input(&path, "was made from other radiance or poses", AGAIN));
        }
        Ok(Some(photometry))
    }

    /// Tells radiance that was divided by it from radiance that was not; `None` where it changes nothing.
    pub fn hash(&self) -> Option<String> {
        if self.vignetting.is_none() && self.views.is_empty() {
            return None;
        }
        let mut hasher = Sha256::new();
        hasher.update(format!("{:?} {:?}", self.vignetting, self.views));
        Some(in_digits(hasher))
    }

    /// The lamp in a view; 1 for sure where it was steady.
    pub fn lamp(&self, name: &str) -> ([f64; 3], [f64; 3]) {
        let view = self.views.iter().find(|view| view.name == name);
        view.map_or(([1.0; 3], [0.0; 3]), |view| (view.gain, view.sigma))
    }

    /// Divides a view's radiance by what the lamp and the lens made of it, and its variance by the square. The doubt of that is not
    /// in the variance, being the same for neighbouring pixels: see [`Photometry::relative_variance`].
    ///
    /// # Errors
    /// [`Error::Request`] where the view has another size than those from which the fall-off was found.
    pub fn correct(&self, name: &str, image: &mut RadianceImage) -> Result<()> {
        if let Some(vignetting) = &self.vignetting {
            let sure = Vignetting { covariance: [[0.0; 5]; 5], ..*vignetting };
            sure.correct(image)?;
        }
        let (gain, _) = self.lamp(name);
        if gain != [1.0; 3] {
            for (radiance, variance) in image.radiance.iter_mut().zip(&mut image.variance) {
                for c in 0..3 {
                    let factor = (1.0 / gain[c]) as f32;
                    radiance[c] *= factor;
                    variance[c] *= factor * factor;
                }
            }
        }
        Ok(())
    }

    /// How sure the correction is: the variance of radiance over radiance at a pixel of a view, mean of the channels.
    pub fn relative_variance(&self, name: &str, pixel: DVec2) -> f64 {
        let (_, sigma) = self.lamp(name);
        let lens =
            self.vignetting.map_or(0.0, |vignetting| vignetting.relative_variance_at(pixel.x, pixel.y));
        lens + sigma.iter().map(|sigma| sigma * sigma).sum::<f64>() / 3.0
    }
}

/// A hash of everything that photometry depends on.
fn made_from(session: &Session) -> Result<String> {
    let mut hasher = Sha256::new();
    hasher.update(registration::made_from(session)?);
    hasher.update(format!("{:?}", session.manifest.lenses));
    let path = Registration::path(session);
    if path.exists() {
        hasher.update(std::fs::read(&path).map_err(Error::io("read", &path))?);
    }
    Ok(in_digits(hasher))
}

fn in_digits(hasher: Sha256) -> String {
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}
