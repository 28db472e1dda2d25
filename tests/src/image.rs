//! What a firmware image takes: its sections, as the linker has placed them.

use std::path::Path;

use object::{Object, ObjectSection, ObjectSymbol, SectionKind};

/// The painted stack's colour, cortex-m-rt's `STACK_PAINT_VALUE`.
const PAINT: u32 = 0xcccc_cccc;

/// A section that takes memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Section {
    /// Its name, such as `.text`.
    pub name: String,
    /// Its size, bytes.
    pub size: u64,
    /// Whether it takes flash: everything but zeros and what is left as it is.
    pub in_flash: bool,
    /// Whether it takes RAM.
    pub in_ram: bool,
}

/// An image's sections and its stack.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// In the order of their addresses.
    pub sections: Vec<Section>,
    /// Where the stack ends at the latest: behind all variables.
    pub stack_end: u32,
    /// Where it begins; it grows downwards.
    pub stack_start: u32,
    /// Whether the image has an allocator.
    pub heap: bool,
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// In words, when the file cannot be read or is no image for the chip.
    pub fn read(path: &Path) -> Result<Self, String> {
        let bytes = std::fs::read(path).map_err(|e| format!("{}: cannot be read: {e}", path.display()))?;
        Self::parse(&bytes).map_err(|what| format!("{}: {what}", path.display()))
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let file = object::File::parse(bytes).map_err(|e| e.to_string())?;
        let symbol = |name: &str| -> Result<u32, String> {
            let found = file.symbols().find(|symbol| symbol.name() == Ok(name));
            found.map(|symbol| symbol.address() as u32).ok_or_else(|| format!("has no symbol {name}"))
        };
        let mut sections: Vec<(u64, Section)> = vec![];
        for section in file.sections().filter(|section| section.size() > 0 && section.address() > 0) {
            let in_ram = (0x1000_0000..0x4000_0000).contains(&section.address())
                && !(0x1fff_0000..0x2000_0000).contains(&section.address());
            let in_flash = !matches!(section.kind(), SectionKind::UninitializedData);
            let name = section.name().map_err(|e| e.to_string())?.to_owned();
            sections.push((section.address(), Section { name, size: section.size(), in_flash, in_ram }));
        }
        sections.sort_by_key(|(address, _)| *address);
        let heap = file.symbols().any(|symbol| symbol.name().is_ok_and(|name| name.contains("__rust_alloc")));
        Ok(Self {
            sections: sections.into_iter().map(|(_, section)| section).collect(),
            stack_end: symbol("_stack_end")?,
            stack_start: symbol("_stack_start")?,
            heap,
        })
    }

    /// Flash, bytes.
    pub fn flash(&self) -> u64 {
        self.sections.iter().filter(|section| section.in_flash).map(|section| section.size).sum()
    }

    /// RAM without the stack, bytes.
    pub fn ram(&self) -> u64 {
        self.sections.iter().filter(|section| section.in_ram).map(|section| section.size).sum()
    }

    /// How deep the stack was at its deepest, bytes, by the paint that is left in `memory`, which reaches from
    /// [`Self::stack_end`] to [`Self::stack_start`].
    pub fn deepest_stack(&self, memory: &[u8]) -> usize {
        let painted = memory.chunks_exact(4).take_while(|word| **word == PAINT.to_le_bytes()).count();
        memory.len() - 4 * painted
    }
}
