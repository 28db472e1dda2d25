//! The texels on which `rigel chart` compares models, as tables for `tools/peers/texels.py`:
//!
//! `cargo run --release -p rigel-tests --example texels -- FOLDER`

use std::path::Path;

use rigel::Result;

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| ".".into());
    rigel_atlas::hand_over(Path::new(&folder))
}
