//! What each photograph of a stack counts for, by how bright a pixel seems to be.

use super::{Mask, NoiseModel, RadianceImage, Response};

/// The topmost bits of a positive float count its logarithm, near enough: 16 steps for an octave.
const SHIFT: u32 = 19;
/// Photographs that together add less than this part of the weight are not looked at.
const NEGLIGIBLE: f64 = 0.01;
/// How far photographs may differ, relative, before it counts as more than noise: what the response, the lens and JPEG leave.
const TOLERANCE: f64 = 0.02;
/// How many standard deviations two photographs may differ by and still agree.
pub(super) const AGREE: f32 = 3.0;
/// Standard deviations beyond which a contradiction is more than noise: once in a thousand pixels.
const BEYOND: f64 = 3.1;
/// A photograph whose expected level comes nearer than this many standard deviations to black or saturation is left out.
const MARGIN: f32 = 2.0;

/// One channel of a stack, the longest exposure first.
pub(super) struct Channel {
    /// Exposure of each level.
    exposure: Vec<f32>,
    /// Per level, the inverse variance of its exposure; 0 where it is too dark or saturated.
    certainty: Vec<f32>,
    dark_level: u16,
    saturated_level: u16,
    times: Vec<f32>,
    per_time: Vec<f32>,
    /// Inverse variance by exposure, 0 where black or saturation is too near.
    expected: Bins<f32>,
    by_radiance: Bins<Bin>,
    /// Per bin and photograph, the factor with which an exposure enters the mean.
    factors: Vec<f32>,
}

/// What to do where a channel is about so bright.
#[derive(Clone, Copy)]
struct Bin {
    /// The photographs to be looked at.
    first: u32,
    end: u32,
    variance: f32,
    /// The response's own part of the variance, relative.
    doubt: f32,
    /// The most that photographs differ by noise: weighted mean square over the square of the mean, less 1.
    most: f32,
}

/// What a channel of a pixel measures.
#[derive(Debug, Clone, Copy)]
pub(super) struct Measured {
    pub radiance: f32,
    /// Infinite where no photograph measured it.
    pub variance: f32,
    pub flags: Mask,
    /// Whether the photographs differ by no more than noise.
    pub agrees: bool,
}

/// What one photograph says of a channel's radiance.
#[derive(Debug, Clone, Copy)]
pub(super) enum Says {
    /// Radiance and its variance.
    Value(f32, f32),
    /// Saturated: not less than this.
    AtLeast(f32),
    /// Too dark: not more than this.
    AtMost(f32),
}

impl Says {
    /// Whether both may be said of one radiance.
    pub fn agrees_with(self, other: Self) -> bool {
        let slack = |value: f32, variance: f32| AGREE * variance.sqrt() + TOLERANCE as f32 * value;
        match (self, other) {
            (Self::Value(a, va), Self::Value(b, vb)) => (a - b).abs() <= slack(a.min(b), va + vb),
            (Self::Value(value, variance), Self::AtLeast(bound))
            | (Self::AtLeast(bound), Self::Value(value, variance)) => value + slack(value, variance) >= bound,
            (Self::Value(value, variance), Self::AtMost(bound))
            | (Self::AtMost(bound), Self::Value(value, variance)) => value - slack(value, variance) <= bound,
            (Self::AtLeast(least), Self::AtMost(most)) | (Self::AtMost(most), Self::AtLeast(least)) => {
                least <= most
            }
            _ => true,
        }
    }
}

impl Channel {
    /// `times`: of the photographs, the longest first.
    pub fn new(response: &Response, noise: &NoiseModel, channel: usize, times: &[f32]) -> Self {
        let table = response.exposure(channel);
        let (dark_level, saturated_level) = (noise.dark_level[channel], noise.saturated_level[channel]);
        let (dark, saturated) = (table[usize::from(dark_level)], table[usize::from(saturated_level)]);
        let variance_at = |x: f32, level: usize| {
            noise.variance(channel, f64::from(x), f64::from(response.slope(channel, level))) as f32
        };
        let certainty = (0..table.len()).map(|z| {
            let valid = z > usize::from(dark_level) && z < usize::from(saturated_level);
            if valid { 1.0 / variance_at(table[z], z) } else { 0.0 }
        });
        let weight_at = |x: f32| {
            let level = table.partition_point(|&entry| entry < x).min(table.len() - 1);
            let variance = variance_at(x, level);
            let margin = MARGIN * variance.sqrt();
            if x - margin > dark && x + margin < saturated { 1.0 / variance } else { 0.0 }
        };
        let lowest = table.iter().copied().find(|&x| x > 0.0).unwrap_or(f32::MIN_POSITIVE);
        let (from, to) = (dark.max(lowest), saturated);
        let expected = Bins::new(from, to, weight_at);
        let mut factors = Vec::new();
        let by_radiance = Bins::new(from / times[0], to / times[times.len() - 1], |radiance| {
            let weights: Vec<f64> = times
                .iter()
                .map(|&t| f64::from(t) * f64::from(t) * f64::from(weight_at(radiance * t)))
                .collect();
            let (bin, shares) = Bin::new(&weights);
            let parts: Vec<(f32, f64)> =
                times.iter().map(|&t| radiance * t).zip(shares.iter().copied()).collect();
            let used = &parts[bin.first as usize..bin.end as usize];
            let doubt = response.variance_of(channel, used) as f32;
            factors.extend(shares.iter().zip(times).map(|(share, &t)| (share / f64::from(t)) as f32));
            let noise = bin.variance / (radiance * radiance);
            let most = bin.most * noise + (TOLERANCE * TOLERANCE) as f32;
            Bin { doubt, most, ..bin }
        });
        Self {
            exposure: table.to_vec(),
            certainty: certainty.collect(),
            dark_level,
            saturated_level,
            times: times.to_vec(),
            per_time: times.iter().map(|t| 1.0 / t).collect(),
            expected,
            by_radiance,
            factors,
        }
    }

    /// What almost every pixel needs: the longest photograph that is not saturated tells which photographs count for how
    /// much, and their mean follows. `longest` is a guess where it is, from the pixel before. `None` where that does not
    /// go, or where the photographs differ by more than noise: then [`Channel::careful`] must look.
    #[inline(always)]
    pub fn quick(&self, level: impl Fn(usize) -> u16, longest: &mut usize) -> Option<(f32, f32)> {
        let mut at = *longest;
        while at > 0 && level(at - 1) < self.saturated_level {
            at -= 1;
        }
        while level(at) >= self.saturated_level {
            at += 1;
            if at == self.times.len() {
                *longest = at - 1;
                return None;
            }
        }
        *longest = at;
        let guess = self.exposure[usize::from(level(at))] * self.per_time[at];
        let index = self.by_radiance.index(guess)?;
        let bin = &self.by_radiance.values[index];
        let (first, end) = (bin.first as usize, bin.end as usize);
        let factors = &self.factors[index * self.times.len()..][..self.times.len()];
        let (mut mean, mut square) = (0.0, 0.0);
        for ((j, &factor), &per_time) in
            (first..end).zip(&factors[first..end]).zip(&self.per_time[first..end])
        {
            let exposure = self.exposure[usize::from(level(j))];
            let part = factor * exposure;
            mean += part;
            square += part * (exposure * per_time);
        }
        // Without a photograph mean and square are 0: not less than.
        (square - mean * mean < bin.most * mean * mean)
            .then_some((mean, bin.variance + bin.doubt * mean * mean))
    }

    /// The mean over some of the photographs, whatever their levels. A noisy level that happens to be low would claim a
    /// small variance and draw the mean down; so the mean found first tells the level that was to be expected in each
    /// photograph, and the variances are evaluated there. For the same reason a photograph is left out where its *expected*
    /// level comes near black or saturation, as long as others remain. `bounds`: whether a photograph that does not measure the
    /// pixel says anything of it ([`is_filling`]).
    #[cold]
    pub fn careful(
        &self,
        photographs: impl Iterator<Item = usize> + Clone,
        level: impl Fn(usize) -> u16,
        bounds: impl Fn(usize) -> bool,
    ) -> Measured {
        let usable = photographs.clone().filter_map(|j| {
            let z = usize::from(level(j));
            (self.certainty[z] > 0.0).then(|| (self.times[j], self.exposure[z], self.certainty[z]))
        });
        let (mut sum, mut weight) = (0.0, 0.0);
        for (t, x, certainty) in usable.clone() {
            sum += t * certainty * x;
            weight += t * t * certainty;
        }
        if weight == 0.0 {
            return self.bound(photographs, level, bounds);
        }
        let first = sum / weight;
        let (mut again, mut square, mut expected, mut count) = (0.0, 0.0, 0.0, 0);
        for (t, x, _) in usable {
            let certainty = self.expected.at(first * t).unwrap_or(0.0);
            again += t * certainty * x;
            square += certainty * x * x;
            expected += t * t * certainty;
            count += usize::from(certainty > 0.0);
        }
        let (mean, weight) = if expected > 0.0 { (again / expected, expected) } else { (first, weight) };
        let doubt = self.by_radiance.at(mean).map_or(0.0, |bin| bin.doubt);
        let spread = square - expected * mean * mean;
        let most = chi_squared(count) + (TOLERANCE * TOLERANCE) as f32 * mean * mean * weight;
        let variance = 1.0 / weight + doubt * mean * mean;
        let mut agrees = count < 2 || spread <= most;
        // What hides a surface may be saturated or black: such a photograph measures nothing, but it contradicts.
        for j in photographs.filter(|&j| bounds(j)) {
            agrees &= match self.says(j, level(j)) {
                Says::Value(..) => true,
                bound => Says::Value(mean, variance + self.bound_variance(j, bound)).agrees_with(bound),
            };
        }
        Measured { radiance: mean, variance, flags: 0, agrees }
    }

    /// How far noise may carry a photograph over a bound that it states: its variance just inside.
    fn bound_variance(&self, photograph: usize, bound: Says) -> f32 {
        let level = match bound {
            Says::AtLeast(_) => self.saturated_level.saturating_sub(1),
            _ => self.dark_level.saturating_add(1),
        };
        let certainty = self.certainty.get(usize::from(level)).copied().unwrap_or(0.0);
        if certainty > 0.0 { self.per_time[photograph].powi(2) / certainty } else { f32::INFINITY }
    }

    /// What one photograph says.
    pub fn says(&self, photograph: usize, level: u16) -> Says {
        let per_time = self.per_time[photograph];
        let z = usize::from(level);
        if level >= self.saturated_level {
            Says::AtLeast(self.exposure[usize::from(self.saturated_level)] * per_time)
        } else if level <= self.dark_level {
            Says::AtMost(self.exposure[usize::from(self.dark_level)] * per_time)
        } else {
            Says::Value(self.exposure[z] * per_time, per_time * per_time / self.certainty[z])
        }
    }

    /// The bound on the radiance of a channel that no photograph measured, and why.
    fn bound(
        &self,
        photographs: impl Iterator<Item = usize> + Clone,
        level: impl Fn(usize) -> u16,
        bounds: impl Fn(usize) -> bool,
    ) -> Measured {
        let within = |photographs: &mut dyn Iterator<Item = usize>| {
            let (mut lower, mut upper) = (0.0f32, f32::INFINITY);
            for j in photographs {
                match self.says(j, level(j)) {
                    Says::AtLeast(bound) => lower = lower.max(bound),
                    Says::AtMost(bound) => upper = upper.min(bound),
                    Says::Value(..) => {}
                }
            }
            (lower, upper)
        };
        let (least, most) = within(&mut photographs.clone().filter(|&j| bounds(j)));
        let (lower, upper) = within(&mut photographs.clone());
        let mut flags = 0;
        if lower > 0.0 {
            flags |= RadianceImage::SATURATED;
        }
        if upper < f32::INFINITY {
            flags |= RadianceImage::DARK;
        }
        let radiance = if lower > 0.0 { lower } else { upper };
        Measured { radiance, variance: f32::INFINITY, flags, agrees: least <= most }
    }
}

/// Whether a pixel is black in some channels and saturated in the others: with such colours alignment tools fill the borders that
/// they shift in; lights hardly ever show them.
pub(super) fn is_filling(channels: &[Channel; 3], levels: [u16; 3]) -> bool {
    let count = |is: &dyn Fn(&Channel, u16) -> bool| {
        channels.iter().zip(levels).filter(|(channel, level)| is(channel, *level)).count()
    };
    let saturated = count(&|channel, level| level >= channel.saturated_level);
    let dark = count(&|channel, level| level <= channel.dark_level);
    saturated > 0 && dark > 0 && saturated + dark == channels.len()
}

impl Bin {
    /// From the photographs' weights: which of them to look at, and each one's share. The limit is still in variances.
    fn new(weights: &[f64]) -> (Self, Vec<f64>) {
        let first = weights.iter().position(|&w| w > 0.0).unwrap_or(0);
        let mut end = weights.iter().rposition(|&w| w > 0.0).map_or(first, |last| last + 1);
        let total: f64 = weights.iter().sum();
        let mut dropped = 0.0;
        while end > first + 1 && dropped + weights[end - 1] < NEGLIGIBLE * total {
            dropped += weights[end - 1];
            end -= 1;
        }
        let kept = total - dropped;
        let share = |j: usize| if (first..end).contains(&j) { weights[j] / kept } else { 0.0 };
        let bin = Self {
            first: first as u32,
            end: end as u32,
            variance: (1.0 / kept) as f32,
            doubt: 0.0,
            most: chi_squared(end - first),
        };
        (bin, (0..weights.len()).map(share).collect())
    }
}

/// The sum of squares, in variances, that so many values about their mean exceed once in a thousand times (Wilson and
/// Hilferty 1931).
fn chi_squared(count: usize) -> f32 {
    if count < 2 {
        return 1.0;
    }
    let freedom = (count - 1) as f64;
    let spread = 2.0 / (9.0 * freedom);
    (freedom * (1.0 - spread + BEYOND * spread.sqrt()).powi(3)) as f32
}

/// A table over the logarithm of a positive number.
struct Bins<T> {
    start: u32,
    values: Vec<T>,
}

impl<T: Copy> Bins<T> {
    fn new(from: f32, to: f32, value: impl FnMut(f32) -> T) -> Self {
        let (start, end) = (from.to_bits() >> SHIFT, to.to_bits() >> SHIFT);
        let middle = |index: u32| f32::from_bits((index << SHIFT) | (1 << (SHIFT - 1)));
        Self { start, values: (start..=end).map(middle).map(value).collect() }
    }

    #[inline(always)]
    fn index(&self, x: f32) -> Option<usize> {
        let index = (x.to_bits() >> SHIFT).wrapping_sub(self.start) as usize;
        (index < self.values.len()).then_some(index)
    }

    fn at(&self, x: f32) -> Option<T> {
        self.index(x).map(|index| self.values[index])
    }
}
