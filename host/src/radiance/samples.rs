//! The few pixels of every stack from which the response and the noise are learnt.

use super::Stack;
use crate::{Error, Result};

/// Side of a sampled block, pixels: half of a JPEG block, so that it never lies across the seam of two.
const SIDE: usize = 4;
/// How many kinds of brightness a stack's blocks are spread over.
const BINS: usize = 32;
/// How many blocks of each brightness a stack gives.
const PER_BIN: usize = 20;

/// Blocks of pixels from the stacks of a session, enough to learn from and small beside the photographs themselves:
/// stacks can be loaded and given one after the other.
///
/// Blocks are spread evenly over brightness and over the picture, and taken from the flatter half of their brightness,
/// where a small movement between exposures does not matter.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    pub(super) blocks: Vec<Block>,
    /// The highest level of the photographs; 0 before the first stack.
    pub(super) white: u16,
    /// Whether a stack's exposure times differed; without that nothing can be learnt.
    pub(super) bracketed: bool,
}

/// One block in every photograph of its stack, the longest exposure first.
#[derive(Debug, Clone)]
pub(super) struct Block {
    pub(super) exposure_s: Vec<f64>,
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
        if self.white == 0 {
            self.white = stack.white();
        }
        if self.white != stack.white() {
            let what =
                format!("its levels go to {}, those of the views before to {}", stack.white(), self.white);
            let remedy = "give the photographs of one camera setting, or recover each setting by itself";
            return Err(Error::input(&stack.pictures[0].path, what, remedy));
        }
        if stack.pictures.len() < 2 {
            return Ok(());
        }
        let mut order: Vec<usize> = (0..stack.pictures.len()).collect();
        order.sort_by(|&a, &b| stack.exposure_s[b].total_cmp(&stack.exposure_s[a]));
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
                let levels = order.iter().map(|&i| block(stack, i, candidate.corner)).collect();
                self.blocks.push(Block { exposure_s: exposure_s.clone(), levels });
            }
        }
        Ok(())
    }
}

/// Whether a block is worth sampling: two photographs at least must have neither clipped it nor left it black.
fn judge(stack: &Stack, corner: (usize, usize)) -> Option<Candidate> {
    let white = stack.white();
    let (mut usable, mut range, mut sum) = (0, 0, 0u64);
    for i in 0..stack.pictures.len() {
        let levels = block(stack, i, corner);
        let (mut low, mut high) = (u16::MAX, 0);
        for level in levels {
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

fn block(stack: &Stack, picture: usize, (x, y): (usize, usize)) -> [[u16; 3]; SIDE * SIDE] {
    let picture = &stack.pictures[picture];
    std::array::from_fn(|i| picture.levels[(y + i / SIDE) * picture.width as usize + x + i % SIDE])
}
