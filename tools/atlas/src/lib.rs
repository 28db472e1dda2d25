//! Speed against accuracy, and where each method breaks: every sweep makes charts, and a CSV of raw figures with the
//! machine on which they were measured.
//!
//! One room for each part of the road: [`radiance`], [`lens`], [`poses`], [`fit`], [`lights`]. Each has a `sweep` of what can be chosen, and most have
//! `regimes` in which something is wrong.

mod figures;
mod fit;
mod lens;
mod lights;
mod machine;
mod poses;
mod radiance;
mod table;

pub use fit::{breaks::error_at, sweep as fit, texels};
pub use lens::sweep as lens;
pub use lights::sweep as lights;
pub use machine::{cpu_seconds, cpu_time, facts};
pub use poses::sweep as poses;
pub use radiance::sweep as radiance;
pub use table::Table;
