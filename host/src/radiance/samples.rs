//! The few pixels of every stack from which the response and the noise are learnt.

use std::path::{Path, PathBuf};

use super::Stack;
use crate::picture::Picture;
use crate::{Error, Result};

/// Side of a sampled block, pixels: half of a JPEG block, so that it never lies across the seam of two.
pub(super) const SIDE: usize = 4;
/// How many kinds of brightness a stack's blocks are spread over.
const BINS: usize = 32;
/// How many blocks of each brightness a stack gives.
const PER_BIN: usize = 60;
/// Blocks beyond this number are thinned out evenly: they would take time and change nothing.
const MOST_BLOCKS: usize = 8000;

/// Blocks of pixels from the stacks of a session, enough to learn from and small beside the photographs themselves:
/// stacks can be loaded and given one after the other.
///
/// Blocks are spread evenly over brightness and over the picture, and taken from the flatter half of their brightness,
/// where a small movement between exposures does not matter.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    pub(super) blocks: Vec<Block>,
    /// The stacks from which they are.
    pub(super) stacks: Vec<Bracket>,
    /// The highest level of the photographs; 0 before the first stack.
    pub(super) white: u16,
    /// Whether a stack's exposure times differed; without that nothing can be learnt.
    pub(super) bracketed: bool,
}

/// The photographs of a stack, the longest exposure first.
#[derive(Debug, Clone)]
pub(super) struct Bracket {
    pub(super) paths: Vec<PathBuf>,
    pub(super) exposure_s: Vec<f64>,
}

/// One block in every photograph of its stack, the longest exposure first.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// Index of its stack.
    pub(super) stack: usize,
    pub(super) levels: Vec<[[u16; 3]; SIDE * SIDE]>,
}

struct Candidate {
    corner: (usize, usize),
    brightness: usize,
    range: u16,
}

impl Samples {
    /// Takes a few hundred blocks from a stack; from a stack of a single photograph none, since it tells nothing.
    ///
    /// # Errors
    /// [`Error::Input`] where its photographs have another depth than the first stack's.
    pub fn add(&mut self, stack: &Stack) -> Result<()> {
        self.admit(stack.white(), &stack.pictures[0].path)?;
        if stack.pictures.len() < 2 {
            return Ok(());
        }
        let order = stack.longest_first();
        let exposure_s: Vec<f64> = order.iter().map(|&i| stack.exposure_s[i]).collect();
        self.bracketed |= exposure_s[0] > exposure_s[exposure_s.len() - 1];

        let mut bins: [Vec<Candidate>; BINS] = [const { Vec::new() }; BINS];
        let (width, height) = (stack.pictures[0].width as usize, stack.pictures[0].height as usize);
        for y in (0..(height / SIDE) * SIDE).step_by(SIDE) {
            for x in (0..(width / SIDE) * SIDE).step_by(SIDE) {
                if let Some(candidate) = judge(stack, (x, y)) {
                    bins[candidate.brightness].push(candidate);
                }
            }
        }
        for mut bin in bins {
            let mut ranges: Vec<u16> = bin.iter().map(|c| c.range).collect();
            ranges.sort_unstable();
            let Some(&median) = ranges.get(ranges.len() / 2) else { continue };
            bin.retain(|c| c.range <= median);
            let step = bin.len().div_ceil(PER_BIN).max(1);
            for candidate in bin.iter().step_by(step) {
                let levels = order.iter().map(|&i| block(&stack.pictures[i], candidate.corner)).collect();
                self.blocks.push(Block { stack: self.stacks.len(), levels });
            }
        }
        let paths = order.iter().map(|&i| stack.pictures[i].path.clone()).collect();
        self.stacks.push(Bracket { paths, exposure_s });
        Ok(())
    }

    /// Takes what another has gathered.
    ///
    /// # Errors
    /// [`Error::Input`] where its photographs have another depth.
    pub fn append(&mut self, other: Self) -> Result<()> {
        if let Some(bracket) = other.stacks.first() {
            self.admit(other.white, &bracket.paths[0])?;
        }
        let before = self.stacks.len();
        self.bracketed |= other.bracketed;
        self.stacks.extend(other.stacks);
        self.blocks
            .extend(other.blocks.into_iter().map(|block| Block { stack: before + block.stack, ..block }));
        Ok(())
    }

    fn admit(&mut self, white: u16, path: &Path) -> Result<()> {
        if self.white == 0 {
            self.white = white;
        }
        if self.white == white {
            return Ok(());
        }
        let what = format!("its levels go to {white}, those of the views before to {}", self.white);
        let remedy = "give the photographs of one camera setting, or recover each setting by itself";
        Err(Error::input(path, what, remedy))
    }

    /// As many blocks as are worth looking at.
    pub(super) fn thinned(&self) -> impl Iterator<Item = &Block> {
        self.blocks.iter().step_by(self.blocks.len().div_ceil(MOST_BLOCKS).max(1))
    }

    /// The exposure times of a block's photographs.
    pub(super) fn exposure_s(&self, block: &Block) -> &[f64] {
        &self.stacks[block.stack].exposure_s
    }
}

/// Whether a block is worth sampling: two photographs at least must have neither clipped it nor left it black.
fn judge(stack: &Stack, corner: (usize, usize)) -> Option<Candidate> {
    let white = stack.white();
    let (mut usable, mut range, mut sum) = (0, 0, 0u64);
    for picture in &stack.pictures {
        let (mut low, mut high) = (u16::MAX, 0);
        for level in lines(picture, corner).flatten() {
            low = low.min(level[1]);
            high = high.max(level[1]);
            sum += u64::from(level[1]);
        }
        if low > 0 && high < white {
            usable += 1;
            range = range.max(high - low);
        }
    }
    let most = u64::from(white) * (SIDE * SIDE * stack.pictures.len()) as u64 + 1;
    (usable >= 2).then(|| Candidate { corner, brightness: (sum * BINS as u64 / most) as usize, range })
}

fn block(picture: &Picture, corner: (usize, usize)) -> [[u16; 3]; SIDE * SIDE] {
    let mut levels = [[0; 3]; SIDE * SIDE];
    levels.chunks_exact_mut(SIDE).zip(lines(picture, corner)).for_each(|(to, line)| to.copy_from_slice(line));
    levels
}

fn lines(picture: &Picture, (x, y): (usize, usize)) -> impl Iterator<Item = &[[u16; 3]]> {
    (y..y + SIDE).map(move |y| &picture.levels[y * picture.width as usize + x..][..SIDE])
}
