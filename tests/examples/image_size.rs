//! The README's table of what the firmware's images take: `tools/firmware size`. Fails beyond the bars.

use std::path::Path;
use std::process::ExitCode;

use rigel_tests::image::Image;

const MOST_FLASH: u64 = 48 * 1024;
const MOST_RAM: u64 = 16 * 1024;

fn main() -> ExitCode {
    let images: Result<Vec<Image>, String> =
        std::env::args().skip(1).map(|path| Image::read(Path::new(&path))).collect();
    let images = match images {
        Ok(images) if images.len() == 2 => images,
        Ok(_) => return fail("image_size CHIP EMULATOR"),
        Err(error) => return fail(&format!("{error}; run tools/firmware build")),
    };
    println!("| bytes | chip | emulator |");
    println!("|---|---|---|");
    let row = |name: &str, size: &dyn Fn(&Image) -> u64| {
        println!("| {name} | {} | {} |", size(&images[0]), size(&images[1]));
    };
    for section in &images[0].sections {
        let size = |image: &Image| {
            image.sections.iter().find(|other| other.name == section.name).map_or(0, |other| other.size)
        };
        row(&format!("`{}`", section.name), &size);
    }
    row(&format!("**flash**, at most {MOST_FLASH}"), &Image::flash);
    row(&format!("**static RAM**, at most {MOST_RAM}"), &Image::ram);
    if images.iter().any(|image| image.flash() > MOST_FLASH || image.ram() > MOST_RAM || image.heap) {
        return fail("an image is too large, or has a heap");
    }
    ExitCode::SUCCESS
}

fn fail(what: &str) -> ExitCode {
    eprintln!("{what}");
    ExitCode::FAILURE
}
