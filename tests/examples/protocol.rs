//! Writes docs/protocol.md anew from the words: `cargo run -p rigel-tests --example protocol`.

#[path = "../tests/protocol/document.rs"]
mod document;

use std::path::Path;

fn main() -> std::io::Result<()> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(document::FILE);
    std::fs::write(&path, document::document())?;
    println!("wrote {}", document::FILE);
    Ok(())
}
