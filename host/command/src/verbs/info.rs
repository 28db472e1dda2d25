//! `rigel info`: what a file is.

use rigel::Result;
use rigel::file::write_bytes;
use rigel::info::{info as look, thumbnail};

use crate::arguments::Info;
use crate::say::say;
use crate::verbs::{require_extension, require_place};

/// `rigel info`.
pub fn info(arguments: &Info) -> Result<()> {
    if let Some(out) = &arguments.png {
        require_extension(out, "png")?;
        require_place(out, arguments.force)?;
    }
    let info = look(&arguments.file)?;
    let picture = arguments.png.as_ref().map(|_| thumbnail(&arguments.file)).transpose()?;
    say!("{}: {}", arguments.file.display(), info.title);
    info.facts.iter().for_each(|fact| say!("  {fact}"));
    if let (Some(out), Some(picture)) = (&arguments.png, picture) {
        write_bytes(out, &picture)?;
        say!("wrote {}", out.display());
    }
    Ok(())
}
