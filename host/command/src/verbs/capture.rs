use crate::arguments::Capture;
use rigel::Result;
pub fn capture(_a: &Capture) -> Result<()> {
    Ok(())
}
