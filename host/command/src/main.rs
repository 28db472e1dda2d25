//! The command `rigel`: parse, call one library function, report.

fn main() {}
