//! The observation map's file: a header and, tile by tile of texels, five half floats for each view and texel.
//!
//! Layout: `RIGELOBS`, the header's length (u64, little-endian), the header (JSON), zeros up to a multiple of 64; then tile
//! after tile, in it view after view, in that texel after texel: radiance R G B and its standard deviation, divided by the
//! header's `unit`, and the mask (0: measured, 1: not measured; the four values are then 0). All tiles have the same size;
//! those at the right and bottom edge are padded. A fit reads one tile at a time and needs no more memory than that.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use glam::DVec3;
use half::f16;
use half::slice::HalfFloatSliceExt;
use memmap2::MmapOptions;
use serde::{Deserialize, Serialize};

use super::TexelObservations;
use crate::geometry::{Surface, Texels};
use crate::{Error, Result};

/// How many texels, of how many tiles, stand for a surface.
const SAMPLED_TEXELS: usize = 400;
const SAMPLED_TILES: usize = 40;
/// So many texels at a time are put together from all views.
const GROUP: usize = 32;
const MAGIC: &[u8; 8] = b"RIGELOBS";
const FORMAT: u32 = 1;
/// Half floats for each observation: radiance, standard deviation, mask.
pub(super) const VALUES: usize = 5;
const ALIGNMENT: u64 = 64;
/// A tile of 32 texels on a side keeps one of 300 views in ten megabytes of memory; no side is longer than 48.
const TILE_SIDE: u32 = 32;
const TILE_SIDES: std::ops::RangeInclusive<u32> = 24..=48;

/// What an observation map says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Version of the file.
    pub format: u32,
    /// The sampled area.
    pub surface: Surface,
    /// How finely it is divided.
    pub texels: Texels,
    /// Columns and rows of a tile.
    pub tile: Texels,
    /// The session's radiance that counts as 1 in the file.
    pub unit: f64,
    /// By what light the radiance was divided, as [`Photometry::hash`](crate::calibration::Photometry::hash) says it.
    #[serde(default)]
    pub photometry: Option<String>,
    /// The views, by index.
    pub views: Vec<ObservedView>,
}

/// One view of an observation map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObservedView {
    /// Its name in the session.
    pub name: String,
    /// Where the camera was, surface frame, metres.
    pub centre_m: DVec3,
    /// The radiance was divided by this, because the exposure time was not known; otherwise 1.
    pub gain: f64,
}

impl Header {
    /// A header in this version's format; `unit` is the radiance that counts as 1 in the file, whose half floats have three
    /// digits between 0.0001 and 65000. Tiles are as large as keeps one in a few megabytes.
    pub fn new(surface: Surface, texels: Texels, unit: f64, views: Vec<ObservedView>) -> Self {
        // Padding is lost disk: a tile divides the map as evenly as it can.
        let side = |count: u32| {
            let padding = |side: &u32| (count.next_multiple_of(*side) - count, side.abs_diff(TILE_SIDE));
            if TILE_SIDES.contains(&count) || count < *TILE_SIDES.start() {
                return count;
            }
            TILE_SIDES.min_by_key(padding).unwrap_or(TILE_SIDE)
        };
        let tile = Texels { columns: side(texels.columns), rows: side(texels.rows) };
        Self { format: FORMAT, surface, texels, tile, unit, photometry: None, views }
    }

    /// Number of tiles along x and y.
    pub fn tiles(&self) -> Texels {
        Texels {
            columns: self.texels.columns.div_ceil(self.tile.columns),
            rows: self.texels.rows.div_ceil(self.tile.rows),
        }
    }

    /// The texels (column, row) of a tile, in the file's order, padding left out as `None`.
    pub(super) fn slots(&self, tile: usize) -> impl Iterator<Item = Option<(u32, u32)>> + use<> {
        let (tiles, size, texels) = (self.tiles(), self.tile, self.texels);
        let left = (tile as u32 % tiles.columns) * size.columns;
        let top = (tile as u32 / tiles.columns) * size.rows;
        (0..size.rows)
            .flat_map(move |y| (0..size.columns).map(move |x| (left + x, top + y)))
            .map(move |(column, row)| (column < texels.columns && row < texels.rows).then_some((column, row)))
    }

    /// Bytes of one view in one tile.
    pub(super) fn block_bytes(&self) -> u64 {
        (self.tile.count() * VALUES * size_of::<f16>()) as u64
    }

    /// Bytes of the header in the file, padding included.
    fn bytes(&self) -> Vec<u8> {
        let json = serde_json::to_vec(self).expect("a header is plain data");
        let mut bytes = MAGIC.to_vec();
        bytes.extend((json.len() as u64).to_le_bytes());
        bytes.extend(json);
        bytes.resize((bytes.len() as u64).next_multiple_of(ALIGNMENT) as usize, 0);
        bytes
    }

    /// Bytes of the whole file.
    pub fn file_bytes(&self) -> u64 {
        self.bytes().len() as u64 + self.tiles_bytes()
    }

    /// Bytes of all tiles.
    fn tiles_bytes(&self) -> u64 {
        self.tiles().count() as u64 * self.views.len() as u64 * self.block_bytes()
    }

    /// Writes the header and makes the file as long as it will be; returns where the tiles start.
    pub(super) fn start(&self, file: &mut File) -> std::io::Result<u64> {
        let bytes = self.bytes();
        file.write_all(&bytes)?;
        file.set_len(self.file_bytes())?;
        Ok(bytes.len() as u64)
    }
}

/// An observation map on disk, open for reading.
#[derive(Debug)]
pub struct ObservationMap {
    path: PathBuf,
    file: File,
    start: u64,
    header: Header,
}

impl ObservationMap {
    /// Opens an observation map.
    ///
    /// # Errors
    /// [`Error::Input`] when the file is something else, of another version, or cut short.
    pub fn open(path: &Path) -> Result<Self> {
        let mut file = File::open(path).map_err(Error::io("read", path))?;
        let length = file.metadata().map_err(Error::io("read", path))?.len();
        let strange = |what: String| Error::input(path, what, "make it with `rigel observe`");
        let mut start = [0; 16];
        let read = file.read_exact(&mut start);
        let json_bytes = u64::from_le_bytes(start[8..].try_into().expect("eight bytes"));
        if read.is_err() || &start[..8] != MAGIC || json_bytes > length - 16 {
            return Err(strange("is not an observation map".into()));
        }
        let mut json = vec![0; json_bytes as usize];
        file.read_exact(&mut json).map_err(Error::io("read", path))?;
        let header: Header = serde_json::from_slice(&json)
            .map_err(|error| strange(format!("has a damaged header ({error})")))?;
        if header.format != FORMAT {
            return Err(strange(format!(
                "has format {}, this is a reader of format {FORMAT}",
                header.format
            )));
        }
        if header.texels.count() == 0
            || header.tile.count() == 0
            || header.unit.is_nan()
            || header.unit <= 0.0
        {
            return Err(strange("has a damaged header (no texels, tile or unit)".into()));
        }
        // Not from the header written again: a number may come back with another digit.
        let start = (16 + json_bytes).next_multiple_of(ALIGNMENT);
        let expected = start + header.tiles_bytes();
        if expected != length {
            return Err(strange(format!("has {length} bytes instead of {expected}: it was cut short")));
        }
        Ok(Self { path: path.into(), file, start, header })
    }

    /// What the map says of itself.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Where the map is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A few hundred texels spread over the whole surface, without some views: enough to settle what is common to it.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be mapped.
    pub fn sample(&self, without: &[u32]) -> Result<Vec<TexelObservations>> {
        Ok(self.spread(SAMPLED_TEXELS)?.into_iter().map(|(_, texel)| texel.without(without)).collect())
    }

    /// About `count` texels spread over the whole surface, or all where there are fewer: (column, row) with their observations.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be mapped.
    pub fn spread(&self, count: usize) -> Result<Vec<((u32, u32), TexelObservations)>> {
        let tiles = self.header.tiles().count();
        let looked_at = tiles.min(SAMPLED_TILES);
        let mut sample = vec![];
        for i in 0..looked_at {
            let tile = self.tile(i * tiles / looked_at)?;
            let step = (tile.len() * looked_at / count.max(1)).max(1);
            sample.extend(tile.into_iter().step_by(step));
        }
        Ok(sample)
    }

    /// Part of the observations (texels times views) that are absent: saturated, too dark, or not in the picture.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be mapped.
    pub fn absent(&self) -> Result<f64> {
        let (mut present, mut all) = (0, 0);
        for tile in 0..self.header.tiles().count() {
            for (_, texel) in self.tile(tile)? {
                present += texel.len();
                all += self.header.views.len();
            }
        }
        Ok(1.0 - present as f64 / all.max(1) as f64)
    }

    /// The texels of one tile, (column, row) with their observations.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be mapped.
    pub fn tile(&self, tile: usize) -> Result<Vec<((u32, u32), TexelObservations)>> {
        let mut texels = vec![];
        self.read_tile(tile, &mut texels)?;
        Ok(texels)
    }

    /// What was measured of texel (`column`, `row`), which the map has; its whole tile is read.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be mapped.
    pub fn texel(&self, column: u32, row: u32) -> Result<TexelObservations> {
        let (tiles, size) = (self.header.tiles(), self.header.tile);
        let tile = self.tile((row / size.rows * tiles.columns + column / size.columns) as usize)?;
        let found = tile.into_iter().find(|(place, _)| *place == (column, row));
        Ok(found.map(|(_, texel)| texel).unwrap_or_default())
    }

    /// Puts the texels of one tile in the place of those of another, whose memory it takes over.
    pub(crate) fn read_tile(
        &self,
        tile: usize,
        texels: &mut Vec<((u32, u32), TexelObservations)>,
    ) -> Result<()> {
        let header = &self.header;
        let block = header.block_bytes() as usize;
        let (views, length) = (header.views.len(), block * header.views.len());
        let places: Vec<(usize, (u32, u32))> =
            header.slots(tile).enumerate().filter_map(|(slot, texel)| Some((slot, texel?))).collect();
        texels.resize_with(places.len(), Default::default);
        for ((at, texel), (_, place)) in texels.iter_mut().zip(&places) {
            *at = *place;
            texel.clear();
            texel.reserve(views);
        }
        if length == 0 {
            return Ok(());
        }
        // SAFETY: the map is read only and lives as long as this call; the file is complete (checked when opened) and was
        // renamed into its place, so nobody of ours writes to it or shortens it.
        #[expect(
            unsafe_code,
            reason = "observation maps are read through a memory map, of which only the tile in use is resident"
        )]
        let bytes = unsafe {
            MmapOptions::new().offset(self.start + (tile * length) as u64).len(length).map(&self.file)
        }
        .map_err(Error::io("map", &self.path))?;
        let unit = header.unit as f32;
        let centre = |(_, (column, row)): &(usize, (u32, u32))| {
            header.surface.texel_centre(header.texels, *column, *row)
        };
        let centres: Vec<DVec3> = places.iter().map(centre).collect();
        // A few texels through all views, then the next: what is being written stays in the cache.
        let groups = texels.chunks_mut(GROUP).zip(places.chunks(GROUP)).zip(centres.chunks(GROUP));
        for ((texels, places), centres) in groups {
            let first = places[0].0;
            let slots = first..places[places.len() - 1].0 + 1;
            let bytes_of = slots.start * VALUES * 2..slots.end * VALUES * 2;
            let mut halves = vec![f16::ZERO; slots.len() * VALUES];
            let mut values = vec![0f32; slots.len() * VALUES];
            for (view, bytes) in bytes.chunks_exact(block).enumerate() {
                for (half, bytes) in halves.iter_mut().zip(bytes[bytes_of.clone()].as_chunks::<2>().0) {
                    *half = f16::from_le_bytes(*bytes);
                }
                halves.convert_to_f32_slice(&mut values);
                let values = values.as_chunks::<VALUES>().0;
                let camera = header.views[view].centre_m;
                for (((_, texel), (slot, _)), centre) in texels.iter_mut().zip(places).zip(centres) {
                    let [r, g, b, sigma, mask] = values[slot - first];
                    if mask == 0.0 {
                        texel.view.push(view as u32);
                        texel.direction.push((camera - centre).as_vec3().normalize());
                        texel.radiance.push([r * unit, g * unit, b * unit]);
                        texel.sigma.push(sigma * unit);
                    }
                }
            }
        }
        Ok(())
    }
}
