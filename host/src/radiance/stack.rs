//! The photographs of one view, with their exposure times.

use crate::picture::Picture;
use crate::session::Session;
use crate::{Error, Result};

/// Photographs of one view from one place, that differ in their exposure time only.
#[derive(Debug, Clone, PartialEq)]
pub struct Stack {
    /// The photographs, in any order.
    pub pictures: Vec<Picture>,
    /// The exposure time of each, seconds.
    pub exposure_s: Vec<f64>,
}

impl Stack {
    /// Puts photographs and their exposure times together.
    ///
    /// # Errors
    /// [`Error::Request`] without photographs or with another number of times; [`Error::Input`] naming the photograph
    /// whose time is not a positive number, or whose size or depth differs from the first one's.
    pub fn new(pictures: Vec<Picture>, exposure_s: Vec<f64>) -> Result<Self> {
        let Some(first) = pictures.first() else {
            return Err(Error::request(
                "a stack without photographs",
                "give at least one photograph per view",
            ));
        };
        if pictures.len() != exposure_s.len() {
            return Err(Error::request(
                format!("{} photographs but {} exposure times", pictures.len(), exposure_s.len()),
                "give one exposure time for each photograph",
            ));
        }
        for (picture, &time_s) in pictures.iter().zip(&exposure_s) {
            if !(time_s.is_finite() && time_s > 0.0) {
                let what = format!("its exposure time is {time_s} s");
                return Err(Error::input(&picture.path, what, "give a positive exposure time in seconds"));
            }
            if (picture.width, picture.height, picture.white) != (first.width, first.height, first.white) {
                let what = format!(
                    "it is {}x{} with levels up to {}, the first photograph of the view is {}x{} with levels up to {}",
                    picture.width, picture.height, picture.white, first.width, first.height, first.white
                );
                let remedy = "give photographs of one view as one camera setting wrote them";
                return Err(Error::input(&picture.path, what, remedy));
            }
        }
        Ok(Self { pictures, exposure_s })
    }

    /// The photographs of a session's view with their times; times that nobody knows count as 1 s.
    pub(crate) fn of_view(session: &Session, view: usize) -> Result<Self> {
        let photographs = session.photographs(view);
        if photographs.is_empty() {
            return Err(Error::input(
                session.folder(),
                format!("has no photograph of view {}", session.manifest.views[view].name),
                "import or capture it again",
            ));
        }
        let pictures = photographs
            .iter()
            .map(|photograph| Picture::read(session.photograph_path(photograph)))
            .collect::<Result<_>>()?;
        let times = photographs.iter().map(|photograph| photograph.exposure_s.unwrap_or(1.0)).collect();
        Self::new(pictures, times)
    }

    /// The photographs' indices, the longest exposure first.
    pub(super) fn longest_first(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.pictures.len()).collect();
        order.sort_by(|&a, &b| self.exposure_s[b].total_cmp(&self.exposure_s[a]));
        order
    }

    /// The highest level of its photographs.
    pub fn white(&self) -> u16 {
        self.pictures[0].white
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stack_of_unlike_photographs_names_the_odd_one() {
        let make = |name: &str, width| Picture {
            path: name.into(),
            width,
            height: 1,
            levels: vec![[1; 3]; width as usize],
            white: 255,
        };
        let error = Stack::new(vec![make("a.jpg", 4), make("b.jpg", 5)], vec![1.0, 2.0]).unwrap_err();
        assert!(matches!(&error, Error::Input { path, .. } if path.ends_with("b.jpg")));
        assert!(Stack::new(vec![make("a.jpg", 4), make("b.jpg", 4)], vec![1.0]).is_err());
        assert!(Stack::new(vec![make("a.jpg", 4)], vec![f64::NAN]).is_err());
        assert!(Stack::new(vec![make("a.jpg", 4)], vec![0.0]).is_err());
        assert!(Stack::new(vec![], vec![]).is_err());
    }
}
