//! Work that the machine cannot hold is refused before it begins, instead of being killed in its midst.

use crate::geometry::Texels;
use crate::{Error, Result};

/// Asks for memory for so many texels of so many bytes.
///
/// # Errors
/// [`Error::Request`] with both numbers when the system says that it has less.
pub(crate) fn require(texels: Texels, bytes: usize) -> Result<()> {
    enough(texels, bytes, available_bytes())
}

/// What new work can use without swapping, as Linux says it; elsewhere nobody is asked.
fn available_bytes() -> Option<u64> {
    let told = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = told.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}

fn enough(texels: Texels, bytes: usize, available: Option<u64>) -> Result<()> {
    let needed = texels.count() as u64 * bytes as u64;
    match available {
        Some(available) if needed > available => Err(Error::request(
            format!(
                "{}x{} texels need {:.1} GB of memory and {:.1} GB are free",
                texels.columns,
                texels.rows,
                needed as f64 / 1e9,
                available as f64 / 1e9
            ),
            "observe fewer texels, fit a smaller model, or use a machine with more memory",
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_million_texels_of_a_large_model_do_not_fit_into_two_gigabytes() {
        let texels = Texels { columns: 4096, rows: 4096 };
        let error = enough(texels, 2200, Some(2 << 30)).unwrap_err().to_string();
        assert!(
            error.contains("4096x4096") && error.contains("36.9 GB") && error.contains("2.1 GB"),
            "{error}"
        );
        assert!(enough(texels, 2200, None).is_ok());
        assert!(enough(Texels { columns: 128, rows: 96 }, 2200, Some(2 << 30)).is_ok());
    }
}
