//! Speed against accuracy, and where each method breaks: every sweep makes charts, and a CSV of raw figures with the
//! machine on which they were measured.
//!
//! One room for each part of the road: [`radiance`], [`lens`], [`poses`], [`fit`], [`mosaic`], [`environment`], [`lights`]. Each has a `sweep` of what
//! can be chosen, and most have `regimes` in which something is wrong.

mod environment;
mod figures;
mod fit;
mod lens;
mod lights;
mod machine;
mod mosaic;
mod poses;
mod radiance;
mod table;

pub use environment::sweep as environment;
pub use fit::{Peers, breaks::error_at, hand_over, sweep as fit, texels};
pub use lens::sweep as lens;
pub use lights::sweep as lights;
pub use machine::{cpu_seconds, cpu_time, facts};
pub use mosaic::sweep as mosaic;
pub use poses::sweep as poses;
pub use radiance::sweep as radiance;
pub use table::Table;
