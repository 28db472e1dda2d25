//! The command `rigel`: parse, call one library function, report.

mod arguments;
mod bench;
mod devices;
mod progress;
mod say;
mod verbs;

use std::process::ExitCode;

use arguments::{Arguments, Verb};
use clap::{CommandFactory, Parser};

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return refuse(&error),
    };
    let outcome = match arguments.verb {
        Verb::Demo(arguments) => verbs::demo(&arguments),
        Verb::Capture(arguments) => verbs::capture(&arguments),
        Verb::Collect(arguments) => verbs::collect(&arguments),
        Verb::Devices => verbs::devices(),
        Verb::Rig(arguments) => verbs::rig(&arguments),
        Verb::Tracker(arguments) => verbs::tracker(&arguments),
        Verb::Import(arguments) => verbs::import(&arguments),
        Verb::Calibrate(arguments) => verbs::calibrate(&arguments),
        Verb::Radiance(arguments) => verbs::radiance(&arguments),
        Verb::Register(arguments) => verbs::register(&arguments),
        Verb::Observe(arguments) => verbs::observe(&arguments),
        Verb::Fit(arguments) => verbs::fit(&arguments),
        Verb::Plan(arguments) => verbs::plan(&arguments),
        Verb::Render(arguments) => verbs::render(&arguments),
        #[cfg(feature = "viewer")]
        Verb::View(arguments) => verbs::view(&arguments),
        #[cfg(not(feature = "viewer"))]
        Verb::View(_) => Err(rigel::Error::request(
            "this rigel was built without its feature `viewer`, which `rigel view` needs",
            "build it with `cargo install --path host/command --features viewer`",
        )),
        Verb::Export(arguments) => verbs::export(&arguments),
        Verb::Info(arguments) => verbs::info(&arguments),
        Verb::Evaluate(arguments) => verbs::evaluate(&arguments),
        Verb::Mosaic(arguments) => verbs::mosaic(&arguments),
        Verb::Lights(arguments) => verbs::lights(&arguments),
        Verb::Update(arguments) => verbs::update(&arguments),
        Verb::Cube(arguments) => verbs::cube(&arguments),
        Verb::Room(arguments) => verbs::room(&arguments),
        Verb::Chart(arguments) => verbs::chart(&arguments),
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

/// Help and version as clap prints them; what cannot be understood as one sentence, like every other error.
fn refuse(error: &clap::Error) -> ExitCode {
    use clap::error::ErrorKind::{DisplayHelp, DisplayHelpOnMissingArgumentOrSubcommand, DisplayVersion};
    if let DisplayHelp | DisplayHelpOnMissingArgumentOrSubcommand | DisplayVersion = error.kind() {
        // Where nobody reads the help there is nobody to tell.
        let _ = error.print();
        return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
    }
    let text = error.to_string();
    let what = text.split("\n\n").next().unwrap_or_default();
    let what: Vec<&str> = what.trim_start_matches("error:").split_whitespace().collect();
    let verb = std::env::args_os().nth(1).and_then(|word| word.into_string().ok());
    let verb = verb.filter(|word| Arguments::command().find_subcommand(word).is_some());
    let help = ["rigel".into(), verb.unwrap_or_default(), "--help".into()].join(" ").replace("  ", " ");
    eprintln!("rigel: {}; see `{help}`", what.join(" "));
    ExitCode::from(2)
}
