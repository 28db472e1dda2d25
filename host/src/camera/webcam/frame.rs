//! A frame as a webcam sends it, and what it shows.

use std::time::SystemTime;

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageFormat, ImageReader};

/// How the bytes of a frame are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    Rgb,
    Bgr,
    /// Luma of each pixel and chroma of each pair, interleaved.
    Yuyv,
    /// Luma, then chroma of each square of four pixels.
    Nv12,
    Grey,
    Jpeg,
}

impl Layout {
    /// What has lost least comes first.
    pub(super) const BEST_FIRST: [Self; 6] =
        [Self::Rgb, Self::Bgr, Self::Yuyv, Self::Nv12, Self::Jpeg, Self::Grey];

    /// The size of a frame; of a JPEG file nobody knows.
    fn size_bytes(self, pixels: usize) -> Option<usize> {
        match self {
            Self::Rgb | Self::Bgr => Some(pixels * 3),
            Self::Yuyv => Some(pixels * 2),
            Self::Nv12 => Some(pixels * 3 / 2),
            Self::Grey => Some(pixels),
            Self::Jpeg => None,
        }
    }
}

/// One frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Frame {
    layout: Layout,
    pub(super) width: u32,
    pub(super) height: u32,
    bytes: Vec<u8>,
    /// When it was taken, where the driver tells.
    pub(super) at: Option<SystemTime>,
}

impl Frame {
    /// A frame from a buffer, which may be longer than the frame.
    pub(super) fn new(
        layout: Layout,
        width: u32,
        height: u32,
        buffer: &[u8],
        at: Option<SystemTime>,
    ) -> Result<Self, String> {
        let size = match layout.size_bytes(width as usize * height as usize) {
            Some(size) => size,
            // The buffer's rest is what an earlier, longer frame has left there. Inside of a JPEG file's scan the end marker
            // cannot stand, and its headers from webcams hold no thumbnail.
            None => {
                buffer.windows(2).position(|pair| pair == [0xff, 0xd9]).map_or(buffer.len() + 1, |at| at + 2)
            }
        };
        let bytes = buffer.get(..size).ok_or("sent a frame that is cut short")?.to_vec();
        Ok(Self { layout, width, height, bytes, at })
    }

    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.bytes == other.bytes
    }

    /// Whether all pixels are the same.
    pub(super) fn is_uniform(&self) -> bool {
        self.rgb().is_ok_and(|rgb| rgb.chunks_exact(3).all(|pixel| pixel == &rgb[..3]))
    }

    /// Red, green and blue levels row by row.
    pub(super) fn rgb(&self) -> Result<Vec<u8>, String> {
        let bytes = &self.bytes;
        Ok(match self.layout {
            Layout::Rgb => bytes.clone(),
            Layout::Bgr => bytes.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]).collect(),
            Layout::Grey => bytes.iter().flat_map(|&level| [level; 3]).collect(),
            Layout::Yuyv => bytes
                .chunks_exact(4)
                .flat_map(|p| [rgb_of(p[0], p[1], p[3]), rgb_of(p[2], p[1], p[3])])
                .flatten()
                .collect(),
            Layout::Nv12 => {
                let (width, height) = (self.width as usize, self.height as usize);
                let (luma, chroma) = bytes.split_at(width * height);
                (0..width * height)
                    .flat_map(|i| {
                        let pair = i / width / 2 * width + i % width / 2 * 2;
                        rgb_of(luma[i], chroma[pair], chroma[pair + 1])
                    })
                    .collect()
            }
            Layout::Jpeg => {
                let whole = with_tables(bytes).ok_or("sent a damaged frame")?;
                let reader = ImageReader::with_format(std::io::Cursor::new(whole), ImageFormat::Jpeg);
                let picture = reader.decode().map_err(|error| format!("sent a damaged frame ({error})"))?;
                if (picture.width(), picture.height()) != (self.width, self.height) {
                    return Err("sent a frame of another size".into());
                }
                picture.into_rgb8().into_raw()
            }
        })
    }
}

/// A JPEG file with Huffman tables. Webcams leave them out, since they are always those of the standard (ITU-T T.81, annex K),
/// with which the encoder here writes too.
fn with_tables(bytes: &[u8]) -> Option<Vec<u8>> {
    let (tables, scan) = huffman_tables(bytes)?;
    if !tables.is_empty() {
        return Some(bytes.to_vec());
    }
    let mut other = vec![];
    JpegEncoder::new(&mut other).write_image(&[0; 3], 1, 1, ExtendedColorType::Rgb8).ok()?;
    let (tables, _) = huffman_tables(&other)?;
    Some([&bytes[..scan], &tables, &bytes[scan..]].concat())
}

/// The segments of a JPEG file that hold Huffman tables, and where its scan begins.
fn huffman_tables(bytes: &[u8]) -> Option<(Vec<u8>, usize)> {
    let (mut tables, mut at) = (vec![], 2);
    loop {
        let &[0xff, kind, high, low] = bytes.get(at..at + 4)? else { return None };
        let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        match kind {
            0xda => return Some((tables, at)),
            0xc4 => tables.extend(bytes.get(at..end)?),
            _ => {}
        }
        at = end;
    }
}

/// ITU-R BT.601 with luma from 16 to 235, as V4L2 has it for webcams (Documentation/userspace-api/media/v4l/colorspaces).
fn rgb_of(luma: u8, blue: u8, red: u8) -> [u8; 3] {
    let luma = 255.0 / 219.0 * (f32::from(luma) - 16.0);
    let [blue, red] = [blue, red].map(|chroma| 255.0 / 224.0 * (f32::from(chroma) - 128.0));
    // The cast stays within 0 to 255.
    [luma + 1.402 * red, luma - 0.344_136 * blue - 0.714_136 * red, luma + 1.772 * blue]
        .map(|level| level.round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(layout: Layout, width: u32, height: u32, bytes: &[u8]) -> Frame {
        Frame::new(layout, width, height, bytes, None).unwrap()
    }

    #[test]
    fn the_colours_of_the_standard_s_bars_are_read_from_every_layout() {
        // ITU-R BT.601, 100 % bars: Y, Cb, Cr of white, yellow, cyan, green, magenta, red, blue, black.
        let bars: [([u8; 3], [u8; 3]); 8] = [
            ([235, 128, 128], [255, 255, 255]),
            ([210, 16, 146], [255, 255, 0]),
            ([170, 166, 16], [0, 255, 255]),
            ([145, 54, 34], [0, 255, 0]),
            ([106, 202, 222], [255, 0, 255]),
            ([81, 90, 240], [255, 0, 0]),
            ([41, 240, 110], [0, 0, 255]),
            ([16, 128, 128], [0, 0, 0]),
        ];
        for ([y, u, v], expected) in bars {
            for (layout, bytes) in [
                (Layout::Yuyv, vec![y, u, y, v, y, u, y, v]),
                (Layout::Nv12, vec![y, y, y, y, u, v]),
                (Layout::Rgb, expected.repeat(4)),
                (Layout::Bgr, [expected[2], expected[1], expected[0]].repeat(4)),
            ] {
                let rgb = frame(layout, 2, 2, &bytes).rgb().unwrap();
                assert_eq!(rgb.len(), 12);
                for (level, want) in rgb.iter().zip(expected.repeat(4)) {
                    assert!(level.abs_diff(want) <= 1, "{layout:?} {rgb:?} {expected:?}");
                }
            }
        }
    }

    #[test]
    fn chroma_goes_to_its_own_pixels() {
        let grey = [[128u8, 128]; 4];
        for red in 0..4 {
            let mut chroma = grey;
            chroma[red] = [128, 240];
            let bytes = [vec![100u8; 16], chroma.concat()].concat();
            let rgb = frame(Layout::Nv12, 4, 4, &bytes).rgb().unwrap();
            for (i, pixel) in rgb.chunks_exact(3).enumerate() {
                let square = i / 8 * 2 + i % 4 / 2;
                assert_eq!(pixel[0] > pixel[1], square == red, "{red} {i}");
            }
        }
        let rgb = frame(Layout::Yuyv, 4, 1, &[50, 128, 60, 128, 70, 128, 80, 240]).rgb().unwrap();
        assert!(rgb[0] == rgb[1] && rgb[3] == rgb[4] && rgb[6] > rgb[7] && rgb[9] > rgb[10]);
        assert!(rgb[0] < rgb[3]);
    }

    fn jpeg() -> Vec<u8> {
        let levels: Vec<u8> = (0..16 * 16 * 3).map(|i| (i / 4) as u8).collect();
        let mut bytes = vec![];
        let encoder = JpegEncoder::new_with_quality(&mut bytes, 90);
        encoder.write_image(&levels, 16, 16, ExtendedColorType::Rgb8).unwrap();
        bytes
    }

    #[test]
    fn a_jpeg_frame_without_tables_and_with_a_rest_behind_it_is_read() {
        let whole = jpeg();
        let expected = frame(Layout::Jpeg, 16, 16, &whole).rgb().unwrap();
        let (tables, scan) = huffman_tables(&whole).unwrap();
        // Annex K: two tables of 12 and two of 162 codes, with the first of the codes for brightness.
        assert!((416..=416 + 4 * 4).contains(&tables.len()));
        assert!(tables.windows(9).any(|codes| codes == [1, 2, 3, 0, 4, 17, 5, 18, 33]));
        let mut bare: Vec<u8> = vec![];
        let mut at = 0;
        while at < scan {
            let is_table = whole[at..].starts_with(&[0xff, 0xc4]);
            let end = if at == 0 {
                2
            } else {
                at + 2 + usize::from(u16::from_be_bytes([whole[at + 2], whole[at + 3]]))
            };
            bare.extend(if is_table { &[] } else { &whole[at..end] });
            at = end;
        }
        bare.extend(&whole[scan..]);
        assert!(bare.len() < whole.len() - 400, "the tables are gone");
        let size = bare.len();
        bare.extend([1, 2, 0xff, 0xd9, 3]);
        let frame = frame(Layout::Jpeg, 16, 16, &bare);
        assert_eq!(frame.bytes.len(), size);
        assert_eq!(frame.rgb().unwrap(), expected);
    }

    #[test]
    fn what_is_cut_short_or_of_another_size_is_refused() {
        for (layout, size) in
            [(Layout::Rgb, 12), (Layout::Bgr, 12), (Layout::Yuyv, 8), (Layout::Nv12, 6), (Layout::Grey, 4)]
        {
            assert!(Frame::new(layout, 2, 2, &vec![0; size], None).is_ok());
            assert!(Frame::new(layout, 2, 2, &vec![0; size - 1], None).is_err());
        }
        let whole = jpeg();
        assert!(Frame::new(Layout::Jpeg, 16, 16, &whole[..whole.len() - 1], None).is_err());
        assert!(frame(Layout::Jpeg, 8, 16, &whole).rgb().unwrap_err().contains("another size"));
        for marker in [0, 2] {
            let mut damaged = whole.clone();
            damaged[marker] = 0;
            assert!(frame(Layout::Jpeg, 16, 16, &damaged).rgb().is_err());
        }
    }

    #[test]
    fn only_a_picture_of_nothing_is_uniform() {
        assert!(frame(Layout::Yuyv, 2, 1, &[16, 128, 16, 128]).is_uniform());
        assert!(!frame(Layout::Yuyv, 2, 1, &[16, 128, 18, 128]).is_uniform());
    }
}
