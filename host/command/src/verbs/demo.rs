use crate::arguments::Demo;
use rigel::Result;
pub fn demo(_a: &Demo) -> Result<()> {
    Ok(())
}
