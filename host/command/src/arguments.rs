//! What can be typed.

mod room;
mod show;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use glam::DVec2;
use rigel::calibration::BoardSize;
use rigel::geometry::{Surface, Texels};
use rigel::units::{
    parse_board, parse_degrees, parse_length_m, parse_part, parse_patch, parse_surface, parse_texels,
};

pub use room::{Cube, LightMethod, Lights, Mosaic, Photographs, Room, Update};
pub use show::{Camera, Export, Info};
#[cfg(feature = "viewer")]
pub use show::{ShadingChoice, View};

/// Captures how a surface looks from every direction and fits the smallest model that reproduces it.
#[derive(Parser)]
#[command(name = "rigel", version, arg_required_else_help = true)]
pub struct Arguments {
    #[command(subcommand)]
    pub verb: Verb,
}

#[derive(Subcommand)]
pub enum Verb {
    /// Run everything on a simulated rig and camera, and write report.html
    Demo(Demo),
    /// Photograph a surface from many directions: a rig and a camera make a session
    Capture(Capture),
    /// Bring the photographs that a captured session's camera kept into the session
    Collect(Collect),
    /// List what is attached: serial ports and whether a rig answers there, cameras
    Devices,
    /// Work with a rig on the bench: home, move, status, watch
    Rig(Rig),
    /// Work with the tracker at a rig: watch
    Tracker(Tracker),
    /// Make a session of photographs that you have: a folder, a CSV or a COLMAP text model
    Import(Import),
    /// Find a camera's lens: photographs of a chessboard make lens.toml, with its uncertainty
    Calibrate(Calibrate),
    /// Turn a session's photographs into radiance: one OpenEXR per view, with variance and mask
    Radiance(Radiance),
    /// Find where each view was taken from: squares in the radiance and commanded angles make registration.toml
    Register(Register),
    /// Gather radiance per texel against direction: radiance and poses make an observation map
    Observe(Observe),
    /// Fit a model to every texel: an observation map makes a parameter map
    Fit(Fit),
    /// Choose the next views: after a coarse pass, the directions where the expected error falls most, ready for `capture --directions`
    Plan(Plan),
    /// See a parameter map from a camera: OpenEXR or PNG
    Render(Render),
    /// See parameter maps in a window, or as the graphics device draws them
    #[cfg(feature = "viewer")]
    View(View),
    #[cfg(not(feature = "viewer"))]
    #[command(hide = true, disable_help_flag = true)]
    View(NoView),
    /// Give parameter maps to others: a web page, or Gaussian splats
    Export(Export),
    /// Tell what a file is and where it came from
    Info(Info),
    /// Compare a parameter map with views that it has not seen: a table, CSV and difference pictures
    Evaluate(Evaluate),
    /// Put photographs taken on the spot on a sphere: an OpenEXR map of the radiance from every direction
    Mosaic(Mosaic),
    /// New photographs of a part of the room bring its map up to date
    Update(Update),
    /// The few lights that stand for a map of the room: a table
    Lights(Lights),
    /// A map of the room as the six faces of a cube: OpenEXR and PNG
    Cube(Cube),
    /// Maps of a room on its model (OBJ, glTF): a texture of radiance, and the light sources with place, size and power
    Room(Room),
    /// Measure speed against accuracy on simulated devices, and what happens where a method breaks: charts and raw figures
    Chart(Chart),
}

/// Whatever `rigel view` is asked in a build that lacks it.
#[cfg(not(feature = "viewer"))]
#[derive(Args)]
pub struct NoView {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _words: Vec<std::ffi::OsString>,
}

#[derive(Args)]
pub struct Chart {
    /// Folder for the page, its charts and the raw figures (CSV)
    #[arg(long, default_value = "rigel-charts")]
    pub out: PathBuf,
    /// What other programs did with the same texels, for the charts of models: a fit_peers.csv of tools/peers/texels.py
    #[arg(long)]
    pub peers: Option<PathBuf>,
}

#[derive(Args)]
pub struct Demo {
    /// Folder for everything the demo makes; replaced if a demo made it before
    #[arg(long, default_value = "rigel-demo")]
    pub out: PathBuf,
}

#[derive(Args)]
pub struct Capture {
    /// Folder of the session
    pub session: PathBuf,
    /// The rig: `simulated`, or its serial port, such as /dev/ttyACM0
    #[arg(long, default_value = "simulated")]
    pub rig: String,
    /// The camera: `simulated`; `webcam` or `webcam:NUMBER`; `trigger`, which the rig releases and whose photographs are
    /// collected afterwards, or `trigger:FOLDER`, where they appear; `folder:FOLDER`, which somebody else fills
    #[arg(long, default_value = "simulated", value_parser = CameraChoice::parse)]
    pub camera: CameraChoice,
    /// The flash-sync of the camera on the trigger is wired: a photograph that it does not confirm is an error
    #[arg(long)]
    pub flash_sync: bool,
    /// Record the tracker at the rig meanwhile, in tracker.jsonl beside the journal
    #[arg(long)]
    pub tracker: bool,
    /// How directions are chosen
    #[arg(long, value_enum, default_value = "icosphere")]
    pub sampling: SamplingChoice,
    /// About how many views (an icosphere of the whole hemisphere has 17, 73, 305 or 1249, and fewer within the limit)
    #[arg(long, default_value_t = 73)]
    pub views: usize,
    /// Largest zenith angle, degrees
    #[arg(long = "zenith-limit", value_name = "DEGREES", default_value_t = 75.0)]
    pub zenith_limit_deg: f64,
    /// Directions from a table with the columns azimuth_deg,zenith_deg, such as `rigel plan` writes; with --resume they are added to
    /// the session
    #[arg(long, value_name = "FILE", conflicts_with_all = ["sampling", "views", "zenith_limit_deg", "seed"])]
    pub directions: Option<PathBuf>,
    /// Seed of the stratified sampling
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The first exposure time of each view, seconds; it is halved until no pixel is saturated
    #[arg(long = "longest-exposure-time", value_name = "SECONDS", default_value_t = 1.0)]
    pub longest_exposure_time_s: f64,
    /// Take the fewest photographs that measure radiance with this relative error, such as 1%, instead of halving the exposure
    /// time; a camera whose photographs are collected afterwards gets every view's whole bracket all the same
    #[arg(long, value_name = "PERCENT", value_parser = parse_part, conflicts_with = "resume")]
    pub relative_error: Option<f64>,
    /// The share of the pixels, in each channel, for which --relative-error is wished
    #[arg(long, value_name = "PERCENT", default_value = "99%", value_parser = parse_part, requires = "relative_error")]
    pub share: f64,
    /// The camera's response, a response.csv of `rigel radiance`, for --relative-error [default: learnt from the first view]
    #[arg(long, value_name = "FILE", requires = "relative_error")]
    pub response: Option<PathBuf>,
    /// Print views, time and disk space, from a rehearsal on the rig's own firmware; move and photograph nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Go on with a session that was interrupted, in whatever way (its own views are kept)
    #[arg(long)]
    pub resume: bool,
    /// Compare every byte of the photographs that are there with the journal's hashes, and take the damaged ones again
    /// [default: their sizes, and every byte of the view that was interrupted]
    #[arg(long, requires = "resume")]
    pub verify: bool,
}

#[derive(Args)]
pub struct Collect {
    /// Folder of the session
    pub session: PathBuf,
    /// Folder of the photographs, every one of the session and no other; they are copied
    pub photographs: PathBuf,
}

#[derive(Debug, Clone, PartialEq)]
pub enum CameraChoice {
    /// Renders a patchwork of known materials where the rig really is
    Simulated,
    /// A webcam by its number
    Webcam(u32),
    /// A camera that the rig releases, and the folder where its photographs appear
    Trigger(Option<PathBuf>),
    /// A folder that somebody else fills
    Folder(PathBuf),
}

impl CameraChoice {
    fn parse(text: &str) -> Result<Self, String> {
        let (kind, which) = text.split_once(':').map_or((text, None), |(kind, which)| (kind, Some(which)));
        match (kind, which) {
            ("simulated", None) => Ok(Self::Simulated),
            ("webcam", which) => which
                .unwrap_or("0")
                .parse()
                .map(Self::Webcam)
                .map_err(|_| "a webcam has a number, such as webcam:0".into()),
            ("trigger", which) if which != Some("") => Ok(Self::Trigger(which.map(PathBuf::from))),
            ("folder", Some(which)) if !which.is_empty() => Ok(Self::Folder(which.into())),
            _ => {
                Err("give simulated, webcam, webcam:NUMBER, trigger, trigger:FOLDER or folder:FOLDER".into())
            }
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
pub enum SamplingChoice {
    Spiral,
    Icosphere,
    LatitudeLongitude,
    Stratified,
}

#[derive(Args)]
pub struct Rig {
    #[command(subcommand)]
    pub verb: RigVerb,
}

#[derive(Subcommand)]
pub enum RigVerb {
    /// Find the switches and go to pan 0, tilt 0
    Home(Bench),
    /// Home, then go to a pan and a tilt
    Move(Move),
    /// Tell where the rig is and what has happened; nothing moves
    Status(Bench),
    /// Tell whatever changes until Ctrl-C; nothing moves
    Watch(Bench),
}

#[derive(Args)]
pub struct Bench {
    /// The rig: `simulated`, or its serial port, such as /dev/ttyACM0
    #[arg(long)]
    pub rig: String,
}

#[derive(Args)]
pub struct Move {
    /// Pan, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true, value_parser = parse_degrees)]
    pub pan: f64,
    /// Tilt, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true, value_parser = parse_degrees)]
    pub tilt: f64,
    #[command(flatten)]
    pub bench: Bench,
}

#[derive(Args)]
pub struct Tracker {
    #[command(subcommand)]
    pub verb: TrackerVerb,
}

#[derive(Subcommand)]
pub enum TrackerVerb {
    /// Show rate, noise and gaps of the tracker's records until Ctrl-C
    Watch(TrackerWatch),
}

#[derive(Args)]
pub struct TrackerWatch {
    #[command(flatten)]
    pub bench: Bench,
    /// How many receivers are plugged in: 1 or 2
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=2))]
    pub stations: u8,
    /// Let the tracker write columns of text instead of binary records
    #[arg(long)]
    pub ascii: bool,
    /// Let the tracker say angles instead of quaternions
    #[arg(long)]
    pub euler: bool,
}

#[derive(Args)]
pub struct Import {
    /// Folder of the photographs (JPEG, PNG, TIFF or OpenEXR)
    pub photographs: PathBuf,
    /// Folder of the new session
    pub session: PathBuf,
    /// Table with the columns file,view,pan_deg,tilt_deg,exposure_s
    #[arg(long, conflicts_with = "colmap")]
    pub csv: Option<PathBuf>,
    /// Folder of a COLMAP text model (cameras.txt, images.txt)
    #[arg(long)]
    pub colmap: Option<PathBuf>,
    /// Size of the sampled area, such as 200mmx150mm
    #[arg(long, value_parser = parse_surface)]
    pub surface: Option<Surface>,
    /// Distance from the rig's centre to the camera, such as 900mm
    #[arg(long = "distance", value_name = "LENGTH", value_parser = parse_length_m)]
    pub distance_m: Option<f64>,
    /// Lens and, if it has them, poses: TOML or JSON with OpenCV's names
    #[arg(long)]
    pub calibration: Option<PathBuf>,
    /// Where the calibration has the centre of the first pixel: 0 as OpenCV, or 0.5
    #[arg(long, default_value_t = 0.0)]
    pub pixel_centre: f64,
    /// Photographs of an evenly lit even surface, for the vignetting
    #[arg(long, num_args = 1..)]
    pub flats: Vec<PathBuf>,
    /// Exposure times in a list as OpenCV's samples have it: file name and 1/t on each line
    #[arg(long, conflicts_with = "csv")]
    pub exposure_times: Option<PathBuf>,
    /// How many photographs of a folder make a view (by default a view starts where an exposure time comes again)
    #[arg(long, conflicts_with_all = ["csv", "colmap"])]
    pub bracket: Option<usize>,
    /// Take photographs without exposure time; `observe` then estimates one gain for each view
    #[arg(long)]
    pub exposure_times_unknown: bool,
}

#[derive(Args)]
pub struct Calibrate {
    /// Photographs of a chessboard, ten or more: tilted to all sides, out to the corners of the picture
    #[arg(required = true)]
    pub photographs: Vec<PathBuf>,
    /// Inner corners of the board, such as 9x6
    #[arg(long, value_parser = parse_board)]
    pub board: BoardSize,
    /// Side of a square, such as 18mm
    #[arg(long = "square", value_name = "LENGTH", value_parser = parse_length_m)]
    pub square_m: f64,
    /// The lens
    #[arg(long, default_value = "lens.toml")]
    pub out: PathBuf,
    /// Terms of the distortion: none, k1, k1k2, k1k2p1p2, k1k2p1p2k3, or auto: the fewest that foretell boards held out as well as more do
    #[arg(long, default_value = "auto")]
    pub model: String,
    /// Folder for residuals.csv, and residuals and uncertainty across the picture as SVG
    #[arg(long)]
    pub residuals: Option<PathBuf>,
    /// Replace the lens that is there
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Radiance {
    /// Folder of the session
    pub session: PathBuf,
    /// What the photographs' levels are worth: recover (from the brackets), srgb, linear, or a response.csv
    #[arg(long, default_value = "recover")]
    pub response: String,
    /// Where the pixels contradict an exposure time: stated refuses the photograph, measured goes by the pixels
    #[arg(long, value_enum, default_value = "stated")]
    pub exposure_times: ExposureTimes,
    /// How photographs are merged: likelihood (the mean of least variance), or debevec (as Debevec and Malik made their published
    /// maps, for comparison)
    #[arg(long, value_enum, default_value = "likelihood")]
    pub merge: MergeChoice,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MergeChoice {
    Likelihood,
    Debevec,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExposureTimes {
    Stated,
    Measured,
}

#[derive(Args)]
pub struct Register {
    /// Folder of the session
    pub session: PathBuf,
    /// The black squares around the surface: TOML with size and centres
    #[arg(long)]
    pub squares: Option<PathBuf>,
    /// The lens, as `rigel calibrate` or OpenCV wrote it [default: the session's]
    #[arg(long)]
    pub lens: Option<PathBuf>,
    /// Replace the registration that is there
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Observe {
    /// Folder of the session
    pub session: PathBuf,
    /// Columns and rows of texels
    #[arg(long, default_value = "512x512", value_parser = parse_texels)]
    pub texels: Texels,
    /// The observation map [default: observations.rigel in the session]
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// A matte patch that tells how bright the lamp was in each view, in place of the surface: its centre (x right and y up from the
    /// centre of the surface) and its side, such as 130mm,0mm,20mm; it may lie beside the surface
    #[arg(long, value_name = "X,Y,SIDE", allow_hyphen_values = true, conflicts_with = "keep_drift", value_parser = parse_patch)]
    pub reference: Option<(DVec2, f64)>,
    /// Do not remove the lamp's drift over the session
    #[arg(long)]
    pub keep_drift: bool,
    /// Do not remove vignetting that the overlapping views tell where there are no flats
    #[arg(long)]
    pub keep_vignetting: bool,
}

#[derive(Args)]
pub struct Fit {
    /// The observation map
    pub observations: PathBuf,
    /// The model: constant, phong to phong4, log-quadratic, msh15 to msh91 and others, which a wrong name lists; `auto` takes for each
    /// texel the smallest of those that predict held-out views best
    #[arg(long, default_value = "auto")]
    pub model: String,
    /// With `auto`: a smaller model suffices that predicts held-out views with at most this mean error, such as 2%
    #[arg(long, value_name = "PERCENT", value_parser = parse_part)]
    pub tolerance: Option<f64>,
    /// Leave out lobes that the views do not determine, instead of keeping the best guess and flagging it
    #[arg(long)]
    pub identified_only: bool,
    /// Names of views to leave out, such as view003,view010
    #[arg(long, value_delimiter = ',')]
    pub without: Vec<String>,
    /// The parameter map [default: the model's name beside the observation map]
    #[arg(long)]
    pub out: Option<PathBuf>,
}

#[derive(Args)]
pub struct Plan {
    /// The observation map of what was photographed so far
    pub observations: PathBuf,
    /// How many views at most
    #[arg(long, default_value_t = 12)]
    pub views: usize,
    /// No more views than bring the expected error to this part of white, such as 1%
    #[arg(long, value_name = "PERCENT", value_parser = parse_part)]
    pub tolerance: Option<f64>,
    /// Largest zenith angle, degrees
    #[arg(long = "zenith-limit", value_name = "DEGREES", default_value_t = 75.0)]
    pub zenith_limit_deg: f64,
    /// Only directions that this rig shows: `simulated`, or its serial port, such as /dev/ttyACM0; nothing moves
    #[arg(long)]
    pub rig: Option<String>,
    /// The table of directions [default: next.csv beside the observation map]
    #[arg(long)]
    pub out: Option<PathBuf>,
}

#[derive(Args)]
pub struct Render {
    /// The parameter map
    pub map: PathBuf,
    /// The picture: .png or .exr
    #[arg(long, default_value = "render.png")]
    pub out: PathBuf,
    #[command(flatten)]
    pub camera: Camera,
    /// Replace the picture that is there
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Evaluate {
    /// The parameter map
    pub map: PathBuf,
    /// List of reference views: `views` in TOML or JSON, or a JSON array; each with file, f or fx fy, cx cy, centre (mm), forward, up
    #[arg(long, required_unless_present = "session")]
    pub references: Option<PathBuf>,
    /// Where the list has the centre of the first pixel: 0 as OpenCV, or 0.5
    #[arg(long, default_value_t = 0.0)]
    pub pixel_centre: f64,
    /// Session whose views are the references
    #[arg(long, conflicts_with = "references", requires = "views")]
    pub session: Option<PathBuf>,
    /// Names of the session's views, such as view003,view010: those that the fit was made --without
    #[arg(long, value_delimiter = ',', conflicts_with = "references", requires = "session")]
    pub views: Vec<String>,
    /// Folder for errors.csv and the pictures [default: the map's name with -errors, beside it]
    #[arg(long)]
    pub out: Option<PathBuf>,
}

fn parse_gamma(text: &str) -> Result<f32, String> {
    let gamma = text.parse().ok().filter(|gamma: &f32| gamma.is_finite() && *gamma > 0.0);
    gamma.ok_or_else(|| "give a positive number, such as 1.5".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_named_by_kind_and_place() {
        let folder = PathBuf::from("a:b");
        for (text, choice) in [
            ("simulated", CameraChoice::Simulated),
            ("webcam", CameraChoice::Webcam(0)),
            ("webcam:2", CameraChoice::Webcam(2)),
            ("trigger", CameraChoice::Trigger(None)),
            ("trigger:a:b", CameraChoice::Trigger(Some(folder.clone()))),
            ("folder:a:b", CameraChoice::Folder(folder)),
        ] {
            assert_eq!(CameraChoice::parse(text), Ok(choice), "{text}");
        }
        for text in
            ["", "webcam:", "webcam:-1", "webcam:a", "trigger:", "folder", "folder:", "simulated:1", "leica"]
        {
            assert!(CameraChoice::parse(text).is_err(), "{text}");
        }
    }
}
