//! The lamp's gains, from the views' gains, in words and numbers.

use super::components::Views;
use super::estimate::{Estimate, MIXES};
use super::middle;
use crate::calibration::{Photometry, ViewGain};

/// What changes with direction by more than this, relative, is worth a word.
const LOOK: f64 = 0.005;

/// The lamp's gains, where it was not steady.
pub(super) fn lamp(estimate: &Estimate, seen: &Views, names: &[&str], found: &mut Photometry) {
    let components = estimate.components(seen);
    let [common, ..] = &components;
    let open =
        middle((0..names.len()).map(|v| estimate.mixed(MIXES[0]).1[(v, v)].sqrt() * MIXES[0][0]).collect());
    let (raw, _) = estimate.mixed(MIXES[0]);
    let look = common.look((raw.norm_squared() / names.len() as f64).sqrt()) * MIXES[0][0];
    if look > LOOK {
        found.notes.push(format!(
            "from direction to direction all of the surface changes by {:.1} % in a way that no model says: that may be its look or the lamp, and stays; a matte patch (--reference) or another order of views would tell",
            100.0 * look
        ));
    }
    if !components.iter().any(|component| component.is_there) {
        if look <= LOOK {
            found.notes.push(format!(
                "the lamp was steady as far as the views tell, each of them to {:.2} %: nothing is changed",
                100.0 * open
            ));
        }
        return;
    }
    let mut views: Vec<ViewGain> =
        names.iter().map(|&name| ViewGain { name: name.into(), gain: [1.0; 3], sigma: [0.0; 3] }).collect();
    for (v, view) in views.iter_mut().enumerate() {
        for c in 0..3 {
            let parts = || components.iter().zip(MIXES).filter(|(component, _)| component.is_there);
            view.gain[c] = parts().map(|(component, mix)| mix[c] * component.lamp[v]).sum::<f64>().exp();
            view.sigma[c] =
                parts().map(|(component, mix)| mix[c].powi(2) * component.variance[v]).sum::<f64>().sqrt();
        }
    }
    let spread = |mix: usize| components[mix].spread();
    let sigma = middle(views.iter().map(|view| view.sigma.iter().sum::<f64>() / 3.0).collect());
    let mut note = match common.is_there {
        true => format!(
            "the lamp's gain varied by {:.1} % over the views (standard deviation)",
            100.0 * spread(0) * MIXES[0][0]
        ),
        false => "the lamp's gain was steady".into(),
    };
    if components[1..].iter().any(|component| component.is_there) {
        note += &format!(", its colour by {:.1} %", 100.0 * spread(1).hypot(spread(2)));
    }
    found.notes.push(format!("{note}; it is removed, each view's to {:.2} % (median)", 100.0 * sigma));
    found.views = views;
}
