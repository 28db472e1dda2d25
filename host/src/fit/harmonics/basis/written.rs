//! The same recurrence written out for a graphics processor.

use super::{Basis, Column, Step};

/// One function of the direction, in the order in which the recurrence reaches it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Written {
    /// WGSL statements that come before it.
    pub statements: String,
    /// The number of its coefficient, in the order of [`Basis::indices`].
    pub index: usize,
    /// Its value, a WGSL expression.
    pub value: String,
}

/// A number as WGSL reads it; the processor has single precision.
fn number(value: f64) -> String {
    format!("({:?})", value as f32)
}

impl Basis {
    /// WGSL for every function below `order` at the direction `d` (a `vec3<f32>`): statement after statement, without a loop,
    /// so that nothing but the coefficients is read from memory.
    pub(in super::super) fn written(self, order: usize) -> Vec<Written> {
        let rule = self.rule(order);
        let place = match self {
            Self::Stretched => {
                "let h = max(d.z, 0.0); let f = sqrt(4.0 * h / (1.0 + h)); let x = d.x * f; let y = d.y * f; let u = 2.0 * h - 1.0;"
            }
            Self::Sphere => "let x = d.x; let y = d.y; let u = d.z;",
            Self::Mirrored => "let x = d.x; let y = d.y; let u = d.z * d.z;",
        };
        let (mut all, mut statements) = (vec![], format!("{place}\n"));
        for (m, Column { start, place, steps }) in rule.columns.iter().enumerate() {
            match m {
                0 => {}
                1 => statements += "let c1 = x; let s1 = y;\n",
                _ => {
                    let of = m - 1;
                    statements +=
                        &format!("let c{m} = c{of} * x - s{of} * y; let s{m} = c{of} * y + s{of} * x;\n");
                }
            }
            let first = Step { a: 0.0, s: *start, c: 0.0, place: *place };
            for (i, step) in std::iter::once(&first).chain(steps).enumerate() {
                let [a, s, c] = [step.a, step.s, step.c].map(number);
                statements += &match i {
                    0 => format!("let p{m}_0 = {s};\n"),
                    1 => format!("let p{m}_1 = ({a} * u + {s} + {c}) * p{m}_0;\n"),
                    _ => format!("let p{m}_{i} = ({a} * u + {s}) * p{m}_{} + {c} * p{m}_{};\n", i - 1, i - 2),
                };
                let mut take = |index, value| {
                    all.push(Written { statements: std::mem::take(&mut statements), index, value });
                };
                if m == 0 {
                    take(step.place.0, format!("p0_{i}"));
                } else {
                    take(step.place.0, format!("(p{m}_{i} * c{m})"));
                    take(step.place.1, format!("(p{m}_{i} * s{m})"));
                }
            }
        }
        all
    }
}
