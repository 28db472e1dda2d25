//! Speed against accuracy, and where each method breaks: every sweep makes charts, and a CSV of raw figures with the
//! machine on which they were measured.

mod machine;
mod radiance;
mod table;

pub use machine::{cpu_seconds, cpu_time, facts};
pub use radiance::sweep as radiance;
pub use table::Table;
