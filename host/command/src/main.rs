//! The command `rigel`: parse, call one library function, report.

mod arguments;
mod devices;
mod progress;
mod verbs;

use std::process::ExitCode;

use arguments::{Arguments, Verb};
use clap::Parser;

fn main() -> ExitCode {
    let outcome = match Arguments::parse().verb {
        Verb::Demo(arguments) => verbs::demo(&arguments),
        Verb::Capture(arguments) => verbs::capture(&arguments),
        Verb::Import(arguments) => verbs::import(&arguments),
        Verb::Radiance(arguments) => verbs::radiance(&arguments),
        Verb::Observe(arguments) => verbs::observe(&arguments),
        Verb::Fit(arguments) => verbs::fit(&arguments),
        Verb::Render(arguments) => verbs::render(&arguments),
        Verb::Evaluate(arguments) => verbs::evaluate(&arguments),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("rigel: {error}");
            let interrupted = matches!(error, rigel::Error::Interrupted);
            ExitCode::from(if interrupted { 130 } else { 1 })
        }
    }
}
