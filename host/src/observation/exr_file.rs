//! Observations for programs that read pictures: OpenEXR with a layer for each view.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use exr::block::UncompressedBlock;
use exr::block::writer::ChunksWriter;
use exr::meta::BlockDescription;
use exr::meta::attribute::{AttributeValue, ChannelDescription, SampleType};
use exr::meta::header::Header;
use exr::prelude::{Compression, LayerAttributes, LineOrder, SmallVec, Text};

use super::ObservationMap;
use crate::file::write_beside;
use crate::progress::Progress;
use crate::{Error, Result};

/// The attribute that tells these files from other pictures: the observation map's header (JSON).
pub(crate) const KIND: &str = "rigelObservations";
const MEANING: &str = "Each view is a layer: the radiance R G B (linear, the session's unit) that it measured of each texel, and its standard deviation sigma; not a number where it measured none. \
    R G B without a layer: the mean over the views. A view's camera stands at centre_m in the attribute rigelObservations: metres from the centre of the surface, x right, y up, z out of it.";

/// What a channel holds: a part (R G B sigma) of a view, or of the mean over the views.
#[derive(Clone, Copy)]
struct Channel {
    view: Option<usize>,
    part: usize,
}

impl ObservationMap {
    /// Writes an OpenEXR file: for each view the channels `NAME.R NAME.G NAME.B NAME.sigma`, and the mean over the views as `R G B`,
    /// in 32-bit floats, ZIP. One row of tiles is in memory at a time. `progress` counts rows of texels.
    ///
    /// # Errors
    /// [`Error::Io`] when a file cannot be read or written; [`Error::Input`] when OpenEXR refuses the map; [`Error::Interrupted`].
    pub fn write_exr(&self, path: &Path, progress: &dyn Progress) -> Result<()> {
        let header = self.header();
        let (columns, rows) = (header.texels.columns as usize, header.texels.rows as usize);
        let mut channels: Vec<(String, Channel)> =
            (0..3).map(|part| (["R", "G", "B"][part].to_owned(), Channel { view: None, part })).collect();
        for (view, observed) in header.views.iter().enumerate() {
            let name = |part: usize| format!("{}.{}", observed.name, ["R", "G", "B", "sigma"][part]);
            channels.extend((0..4).map(|part| (name(part), Channel { view: Some(view), part })));
        }
        channels.sort_by(|(a, _), (b, _)| a.cmp(b));
        let described = |name: &String| {
            let text = Text::new_or_none(name).ok_or_else(|| {
                let what =
                    format!("the view of the channel {name} has letters that OpenEXR's names cannot hold");
                Error::input(path, what, "rename the view, or write them with --zarr")
            })?;
            Ok(ChannelDescription::named(text, SampleType::F32))
        };
        let list: SmallVec<[ChannelDescription; 5]> =
            channels.iter().map(|(name, _)| described(name)).collect::<Result<_>>()?;
        let json = plain(&serde_json::to_string(header).expect("a header is plain data"));
        let mut attributes = LayerAttributes { comments: Some(MEANING.into()), ..LayerAttributes::default() };
        attributes.software_name = Some(concat!("rigel ", env!("CARGO_PKG_VERSION")).into());
        attributes.other.insert(Text::from(KIND), AttributeValue::Text(json.as_str().into()));
        let layer = Header::new("observations".into(), (columns, rows), list)
            .with_attributes(attributes)
            // A block is a row.
            .with_encoding(Compression::ZIP1, BlockDescription::ScanLines, LineOrder::Increasing);
        let channels: Vec<Channel> = channels.into_iter().map(|(_, channel)| channel).collect();
        write_beside(path, |temporary| {
            let file = File::create(temporary).map_err(Error::io("write", path))?;
            let (mut strip, mut stopped) = (Strip::default(), None);
            let written =
                exr::block::write(BufWriter::new(file), SmallVec::from(vec![layer]), true, |meta, chunks| {
                    let blocks =
                        meta.enumerate_ordered_header_block_indices().map_while(|(number, index)| {
                            let row = index.pixel_position.y();
                            let data =
                                progress.step(row, rows).and_then(|()| strip.row(self, row, &channels));
                            let data = data.map_err(|error| stopped = Some(error)).ok()?;
                            Some((number, UncompressedBlock { index, data }))
                        });
                    chunks.on_progress(|_| {}).compress_all_blocks_parallel(&meta, blocks)
                });
            match (stopped, written) {
                (Some(error), _) => Err(error),
                (None, Err(exr::error::Error::Io(source))) => Err(Error::io("write", path)(source)),
                (None, Err(other)) => Err(Error::input(
                    path,
                    format!("OpenEXR refuses the observations: {other}"),
                    "write them with --zarr",
                )),
                (None, Ok(())) => progress.step(rows, rows),
            }
        })
    }
}

/// JSON in ASCII: what else a string holds becomes an escape.
fn plain(json: &str) -> String {
    let mut units = [0; 2];
    json.chars().fold(String::with_capacity(json.len()), |mut text, letter| {
        match letter.is_ascii() {
            true => text.push(letter),
            false => {
                letter.encode_utf16(&mut units).iter().for_each(|unit| text += &format!("\\u{unit:04x}"))
            }
        }
        text
    })
}

/// One row of tiles, decoded.
#[derive(Default)]
struct Strip {
    first_row: usize,
    rows: usize,
    /// Row by row, channel by channel, column by column.
    values: Vec<f32>,
}

impl Strip {
    /// The bytes of one row of texels, channel after channel.
    fn row(&mut self, map: &ObservationMap, row: usize, channels: &[Channel]) -> Result<Vec<u8>> {
        let header = map.header();
        let (columns, height) = (header.texels.columns as usize, header.tile.rows as usize);
        let length = channels.len() * columns;
        if !(self.first_row..self.first_row + self.rows).contains(&row) {
            (self.first_row, self.rows) = (row / height * height, height);
            self.values.clear();
            self.values.resize(height * length, f32::NAN);
            let tiles = header.tiles().columns as usize;
            for tile in 0..tiles {
                for ((column, row), texel) in map.tile(row / height * tiles + tile)? {
                    let mut of_view = vec![None; header.views.len()];
                    texel.view.iter().enumerate().for_each(|(i, &view)| of_view[view as usize] = Some(i));
                    for (c, channel) in channels.iter().enumerate() {
                        let value = |i: usize| match channel.part {
                            3 => texel.sigma[i],
                            part => texel.radiance[i][part],
                        };
                        let value = match channel.view {
                            Some(view) => of_view[view].map(value),
                            None if texel.is_empty() => None,
                            None => Some((0..texel.len()).map(value).sum::<f32>() / texel.len() as f32),
                        };
                        let place = (row as usize - self.first_row) * length + c * columns + column as usize;
                        self.values[place] = value.unwrap_or(f32::NAN);
                    }
                }
            }
        }
        let start = (row - self.first_row) * length;
        Ok(bytemuck::cast_slice(&self.values[start..start + length]).to_vec())
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn json_in_ascii_means_the_same() {
        let told = serde_json::to_string(&["Ωmega 𝄞", "plain \\ \"é\""]).unwrap();
        let plain = super::plain(&told);
        assert!(plain.is_ascii() && plain != told);
        let read = |json: &str| serde_json::from_str::<Vec<String>>(json).unwrap();
        assert_eq!(read(&plain), read(&told));
    }
}
