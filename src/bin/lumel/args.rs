//! The arguments and what they mean, with the help that teaches them.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{Parser, Subcommand, ValueEnum};
use lumel::atlas::Uv;
use lumel::bake::{Options, Output, Refine};
use lumel::lights::sky;
use lumel::output::Export;
use lumel::scene;
use lumel::transport::Estimator;

use super::environment::Environmental;
use super::points::Table;

const AFTER_HELP: &str = "\
Examples:
  lumel inspect level.glb                     what is in it, what is odd, what a bake would cost
  lumel bake level.glb --preset draft         a quick look, into level.lumel/
  lumel bake level.glb -o out --directional   light vectors even without normal maps
  lumel probe level.glb --points p.csv        the light at single points
  lumel sky sky.hdr -n 256                    a picture of the sky as 256 directions
  lumel view level.lumel                      looks at a bake in a browser

Units: metres, Y up, right-handed; radiance in nit, irradiance and fluence in lux.

Exit codes:
  0    done
  1    the scene or a file is bad; the message says which, where and why
  2    wrong use
  3    done, but with a shortfall that is stated
  130  interrupted";

const BAKE_HELP: &str = "\
Density per object: {\"lumel\": {\"scale\": 2}} in a node's extras gives it twice the texels per metre,
0 none: it then only casts shadows.

Files in DIR, <scene> being the scene's file name without its ending and <P> the page:
  <scene>_lm<P>_E.exr            irradiance at the flat normal, lux
  <scene>_lm<P>_{Gr,Gg,Gb}.exr   light vector per colour channel, world space, lux
  <scene>_lm<P>_phi.exr          fluence, lux
  <scene>_lm<P>_light.ktx2       light vector and fluence as one texture (--outputs ktx2)
  <scene>_lm<P>_preview.png      a picture of E
  <scene>.glb                    the scene with the lightmap's texture coordinates
  <scene>.lumel.json             the manifest
They appear together when the bake is done; an interrupted bake leaves those of the last one.

Examples:
  lumel bake level.glb
  lumel bake level.glb -o out --texels-per-metre 16 --page 4096
  lumel bake level.glb --outputs e,preview --json";

const PROBE_HELP: &str = "\
FILE holds one point and one normal per row:
  .csv   header x,y,z,nx,ny,nz; lines that start with # are skipped
  .npy   shape (N, 6), f32 or f64
Positions in metres; normals need not have length 1.

The result has 44 columns, f64, a row per point in the order of FILE:
  e_r e_g e_b            irradiance at the point's own normal, lux
  gr_x gr_y .. gb_z      light vector per colour channel, world space, lux
  phi_r phi_g phi_b      fluence, lux
  jr_xx jr_xy .. jb_zz   jr_xy is the change of gr_x along y, lux per metre;
                         0 where the estimator gives no derivative (sampled light)
  error                  estimated absolute error of e, largest channel, lux
  rays                   shadow rays cast

Examples:
  lumel probe level.glb --points points.csv
  lumel probe level.glb --points points.npy -o light.npy --samples 1024";

const INSPECT_HELP: &str = "\
The atlas is really laid out, at the density given, so that texels, pages and memory are true figures.

Examples:
  lumel inspect level.glb
  lumel inspect level.glb --texels-per-metre 16 --json";

const SKY_HELP: &str = "\
FILE is a latitude-longitude picture, .hdr or .exr, at most 8192 x 4096. Its centre is +X, +Z is right of it, the
top row is +Y: as three.js, model-viewer and Blender's glTF export have it.

The rule is stored beside it as FILE.sky.json: unit directions, and for the cell of each, the part of the sphere
nearer to it than to the others,
  fluence        integral of radiance, lux, linear RGB
  lightVector    integral of radiance times direction, lux, one vector per colour channel
  solidAngle     steradians
together with a hash of the picture and the options. The same command again finds it and does nothing.

Examples:
  lumel sky sky.hdr -n 256
  lumel sky sky.exr -n 32 -m 8                8 interleaved rules of 32 directions
  lumel sky noon.hdr -n 64 --split-bright     the sun as a polygon of its own

Source: Kollig and Keller, Efficient Illumination by High Dynamic Range Images, 2003.";

const VIEW_HELP: &str = "\
Without --html a server answers on 127.0.0.1, to this machine only, until Ctrl-C. It gives out the files of
this one bake. With --html the viewer and the bake become one file, to keep or to send.

Examples:
  lumel view level.lumel
  lumel view level.lumel --html level.html";

/// Bakes light into the textures of a glTF level: light vectors, fluence and irradiance from area lights.
#[derive(Debug, Parser)]
#[command(version, after_help = AFTER_HELP, max_term_width = 110)]
pub(crate) struct Args {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Bakes a scene and writes its lightmaps
    Bake(Bake),
    /// Evaluates the light at given points, without an atlas: a light meter
    Probe(Probe),
    /// Says what is in a scene, what is odd about it, what a bake would do and leave out, and what it needs
    Inspect(Inspect),
    /// Turns a picture of the sky into a few directions with their light, and stores them beside it
    Sky(Sky),
    /// Shows a bake in a browser: its light, what it is made of, how good it is
    View(View),
}

impl Command {
    /// `None` for commands that do no work of their own.
    pub(crate) fn manner(&self) -> Option<&Manner> {
        match self {
            Self::Bake(bake) => Some(&bake.general.manner),
            Self::Probe(probe) => Some(&probe.general.manner),
            Self::Inspect(inspect) => Some(&inspect.general.manner),
            Self::Sky(sky) => Some(&sky.manner),
            Self::View(_) => None,
        }
    }

    /// What to say when Ctrl-C ended it.
    pub(crate) fn interrupted(&self) -> &'static str {
        match self {
            Self::Bake(_) => "interrupted; the previous bake is untouched",
            Self::Probe(_) | Self::Inspect(_) | Self::Sky(_) | Self::View(_) => {
                "interrupted; nothing was written"
            }
        }
    }
}

#[derive(Debug, clap::Args)]
#[command(after_help = BAKE_HELP)]
pub(crate) struct Bake {
    #[command(flatten)]
    pub(crate) general: General,

    /// Directory for the files [default: <scene>.lumel beside the scene]
    #[arg(short = 'o', value_name = "DIR")]
    pub(crate) directory: Option<PathBuf>,

    #[command(flatten)]
    pub(crate) quality: Quality,

    /// Files to write, separated by commas [default: what the plan finds useful; `lumel inspect` shows it]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub(crate) outputs: Option<Vec<OutputArg>>,

    /// Layouts that engines already read, to write beside them, separated by commas
    #[arg(long = "export", value_name = "LIST", value_delimiter = ',')]
    pub(crate) exports: Vec<ExportArg>,

    /// Stores the maps as 32-bit floats, not as halves
    #[arg(long)]
    pub(crate) float: bool,
}

#[derive(Debug, clap::Args)]
#[command(after_help = PROBE_HELP)]
pub(crate) struct Probe {
    #[command(flatten)]
    pub(crate) general: General,

    /// Points and normals, .csv or .npy
    #[arg(long, value_name = "FILE", value_parser = table())]
    pub(crate) points: Table,

    /// Where the result goes, .csv or .npy [default: as CSV on standard output]
    #[arg(short = 'o', value_name = "FILE", value_parser = table(), required_if_eq("json", "true"))]
    pub(crate) output: Option<Table>,

    #[command(flatten)]
    pub(crate) sampling: Sampling,

    #[command(flatten)]
    pub(crate) sizes: Sizes,
}

#[derive(Debug, clap::Args)]
#[command(after_help = INSPECT_HELP)]
pub(crate) struct Inspect {
    #[command(flatten)]
    pub(crate) general: General,

    #[command(flatten)]
    pub(crate) quality: Quality,
}

#[derive(Debug, clap::Args)]
#[command(after_help = SKY_HELP)]
pub(crate) struct Sky {
    /// The picture, .hdr or .exr
    #[arg(value_name = "FILE")]
    pub(crate) path: PathBuf,

    /// Directions of a rule [default: 256]
    #[arg(short = 'n', long, value_name = "N", allow_negative_numbers = true, value_parser = whole(1..=4096))]
    directions: Option<u32>,

    /// Interleaved rules; together they have at most 4096 directions [default: 1]
    #[arg(short = 'm', long, value_name = "M", allow_negative_numbers = true, value_parser = whole(1..=4096))]
    sets: Option<u32>,

    /// Iterations that interleave them [default: 4]
    #[arg(short = 'k', long, value_name = "K", allow_negative_numbers = true, value_parser = whole(0..=1000))]
    iterations: Option<u32>,

    /// Largest angle between a direction and the centroid of its cell's light, radians [default: 0.01]
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = real(1e-6..=1.0))]
    max_decentration: Option<f64>,

    /// Takes the sun and other small bright lights out of the picture, as polygons of their own
    #[arg(long)]
    split_bright: bool,

    /// Where the rule goes [default: FILE.sky.json beside FILE]
    #[arg(short = 'o', value_name = "RULE")]
    pub(crate) output: Option<PathBuf>,

    #[command(flatten)]
    pub(crate) manner: Manner,
}

impl Sky {
    /// The options of the library.
    pub(crate) fn options(&self) -> sky::Options {
        let mut options = sky::Options::default();
        for (option, given) in [
            (&mut options.directions, self.directions),
            (&mut options.sets, self.sets),
            (&mut options.iterations, self.iterations),
        ] {
            if let Some(given) = given {
                *option = given as usize;
            }
        }
        if let Some(angle) = self.max_decentration {
            options.max_decentration = angle;
        }
        options.split_bright = self.split_bright;
        options
    }
}

#[derive(Debug, clap::Args)]
#[command(after_help = VIEW_HELP)]
pub(crate) struct View {
    /// Directory of a bake, or its .lumel.json where there are several
    #[arg(value_name = "DIR")]
    pub(crate) path: PathBuf,

    /// Writes the viewer with the bake inside to FILE, and serves nothing
    #[arg(long, value_name = "FILE")]
    pub(crate) html: Option<PathBuf>,

    /// Prints the address and opens no browser
    #[arg(long, conflicts_with = "html")]
    pub(crate) no_open: bool,

    /// Port of the server; 0 takes a free one
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "html")]
    pub(crate) port: u16,
}

/// What every subcommand that reads a scene takes.
#[derive(Debug, clap::Args)]
pub(crate) struct General {
    /// The level, .gltf or .glb
    #[arg(value_name = "SCENE")]
    pub(crate) path: PathBuf,

    /// Which of the document's scenes, counted from 0 [default: the document's default scene]
    #[arg(long, value_name = "N")]
    scene: Option<usize>,

    #[command(flatten)]
    pub(crate) environment: Environmental,

    #[command(flatten)]
    pub(crate) manner: Manner,
}

/// How a subcommand works and what it prints.
#[derive(Debug, clap::Args)]
pub(crate) struct Manner {
    /// Worker threads; the result does not depend on it [default: one per core]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole(1..=1024))]
    threads: Option<u32>,

    /// Prints one JSON object on standard output instead of text
    #[arg(long)]
    pub(crate) json: bool,

    /// Prints errors only
    #[arg(short, long, conflicts_with = "verbose")]
    pub(crate) quiet: bool,

    /// Says where in the scene each warning was met
    #[arg(short, long)]
    pub(crate) verbose: bool,
}

impl General {
    pub(crate) fn scene_options(&self) -> scene::Options {
        scene::Options { scene: self.scene }
    }
}

impl Manner {
    pub(crate) fn threads(&self) -> Option<usize> {
        self.threads.map(|threads| threads as usize)
    }
}

/// How a partly hidden light is integrated.
#[derive(Debug, clap::Args)]
pub(crate) struct Sampling {
    /// How lights that something may hide are integrated; the others take the closed form
    #[arg(long, value_name = "NAME", default_value = "auto")]
    estimator: EstimatorArg,

    /// Shadow rays per point and partly hidden light, where light is sampled [default: 64]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole(1..=65536))]
    samples: Option<u32>,

    /// Among 16 lights or more: those that could give less than this share of the light are tested by one shadow ray at most, and none once
    /// the rest is below this share of what is known; 0 integrates all. Radiance's -dt [default: the tolerance; 0 for
    /// probe, which gives no derivatives with any other]
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = real(0.0..=1.0))]
    direct_threshold: Option<f64>,

    /// How many of the n lights left to test count as the rest: the largest n to the power of X. Radiance's -dc [default: 0.5]
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = real(0.0..=1.0))]
    direct_certainty: Option<f64>,
}

/// How large authored lights are whose nodes do not say it.
#[derive(Debug, clap::Args)]
pub(crate) struct Sizes {
    /// Radius in metres of point and spot lights; 0 casts hard shadows. A node's extras win: `{"lumel": {"radius": 0.1}}` [default: 0]
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = real(0.0..=1e3))]
    light_radius: Option<f64>,

    /// Angular diameter in degrees of directional lights; 0 casts hard shadows. A node's extras win, in radians as all of glTF:
    /// `{"lumel": {"angular_diameter": 0.00925}}` [default: 0.53, the sun's]
    #[arg(long, value_name = "DEG", allow_negative_numbers = true, value_parser = real(0.0..=90.0))]
    sun_angle: Option<f64>,
}

/// What decides size and accuracy of a bake.
#[derive(Debug, clap::Args)]
pub(crate) struct Quality {
    /// Short for the options it names; an option given beside it wins
    #[arg(long, value_name = "NAME", default_value = "default")]
    preset: Preset,

    /// Texels per metre of surface [default: 8, a texel of 12.5 cm]
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = real(1e-3..=1e4))]
    texels_per_metre: Option<f64>,

    /// Largest side of a page, in texels [default: 2048]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole(64..=16384))]
    page: Option<u32>,

    /// Gap between charts, in texels; their borders are continued into it [default: 4]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole(2..=64))]
    padding: Option<u32>,

    /// Texture coordinates of the lightmap
    #[arg(long, value_name = "WHICH", default_value = "auto")]
    uv: UvArg,

    /// Target error of E relative to the page's maximum [default: 0.004, one step of 255]
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = real(1e-6..=1.0))]
    tolerance: Option<f64>,

    /// Where light is evaluated; elsewhere it is interpolated by its derivatives
    #[arg(long, value_name = "WHERE", default_value = "off")]
    refine: RefineArg,

    #[command(flatten)]
    sampling: Sampling,

    #[command(flatten)]
    sizes: Sizes,

    /// Stores the light vector even when no material has a normal map
    #[arg(long)]
    directional: bool,
}

impl Bake {
    /// The options of the library: the preset's, then those given.
    pub(crate) fn options(&self) -> Options {
        let mut options = self.quality.options();
        self.general.environment.apply(&mut options);
        options.float = self.float;
        options.exports = self.exports.iter().map(|&export| export.into()).collect();
        options.outputs = self
            .outputs
            .as_ref()
            .map(|outputs| outputs.iter().map(|&output| output.into()).collect());
        options
    }
}

impl Probe {
    /// The options of the library.
    pub(crate) fn options(&self) -> Options {
        let mut options = Options::default();
        self.sampling.apply(&mut options);
        self.sizes.apply(&mut options);
        self.general.environment.apply(&mut options);
        options
    }
}

impl Inspect {
    /// The options of the library.
    pub(crate) fn options(&self) -> Options {
        let mut options = self.quality.options();
        self.general.environment.apply(&mut options);
        options
    }
}

impl Sizes {
    fn apply(&self, options: &mut Options) {
        if let Some(radius) = self.light_radius {
            options.lights.light_radius = radius;
        }
        if let Some(degrees) = self.sun_angle {
            options.lights.sun_angle = degrees.to_radians();
        }
    }
}

impl Sampling {
    fn apply(&self, options: &mut Options) {
        options.transport.estimator = self.estimator.into();
        if let Some(samples) = self.samples {
            options.transport.samples = samples;
        }
        options.direct_threshold = self.direct_threshold;
        if let Some(certainty) = self.direct_certainty {
            options.transport.direct_certainty = certainty;
        }
    }
}

impl Quality {
    /// The preset's options, then those given.
    pub(crate) fn options(&self) -> Options {
        let mut options = self.preset.options();
        if let Some(density) = self.texels_per_metre {
            options.atlas.texels_per_metre = density;
        }
        if let Some(page) = self.page {
            options.atlas.page = page;
        }
        if let Some(padding) = self.padding {
            options.atlas.padding = padding;
        }
        options.atlas.uv = self.uv.into();
        if let Some(tolerance) = self.tolerance {
            options.tolerance = tolerance;
        }
        self.sampling.apply(&mut options);
        self.sizes.apply(&mut options);
        options.refine = self.refine.into();
        options.directional = self.directional;
        options
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Preset {
    /// A quick look: --texels-per-metre 4 --samples 16 --tolerance 0.016
    Draft,
    /// --texels-per-metre 8 --samples 64 --tolerance 0.004
    Default,
    /// For shipping: --texels-per-metre 16 --samples 256 --tolerance 0.001
    Final,
}

impl Preset {
    /// The set that its help states.
    fn options(self) -> Options {
        let mut options = Options::default();
        let (density, samples, tolerance) = match self {
            Self::Draft => (4.0, 16, 0.016),
            Self::Default => return options,
            Self::Final => (16.0, 256, 0.001),
        };
        options.atlas.texels_per_metre = density;
        options.transport.samples = samples;
        options.tolerance = tolerance;
        options
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum EstimatorArg {
    /// Exact, except behind masked occluders and where very many edges make it dearer than rays
    Auto,
    /// The contour of the visible part, clipped exactly: no rays, no noise, with derivatives
    Exact,
    /// Stratified shadow rays over the light's area
    Sampled,
    /// The contour traced with shadow rays as published by Vedel in 1993, for comparison; misses small occluders
    Vedel,
    /// The contour of the visible part, found by few rays and followed along the meshes; exact where that is doubtful
    Traced,
}

impl From<EstimatorArg> for Estimator {
    fn from(estimator: EstimatorArg) -> Self {
        match estimator {
            EstimatorArg::Auto => Self::Auto,
            EstimatorArg::Exact => Self::Exact,
            EstimatorArg::Sampled => Self::Sampled,
            EstimatorArg::Vedel => Self::Vedel,
            EstimatorArg::Traced => Self::Traced,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum RefineArg {
    /// As texels where that is cheaper, else as off; `lumel inspect` says which and why
    Auto,
    /// At the texels between which it bends, by its derivatives
    Texels,
    /// At every texel: the reference
    Off,
}

impl From<RefineArg> for Refine {
    fn from(refine: RefineArg) -> Self {
        match refine {
            RefineArg::Auto => Self::Auto,
            RefineArg::Texels => Self::Texels,
            RefineArg::Off => Self::Off,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum UvArg {
    /// The authored second set where it lies in 0..1 and does not overlap, else an unwrap
    Auto,
    /// The authored second set wherever it lies in 0..1, even when it overlaps
    Keep,
    /// Always an unwrap
    Unwrap,
}

impl From<UvArg> for Uv {
    fn from(uv: UvArg) -> Self {
        match uv {
            UvArg::Auto => Self::Auto,
            UvArg::Keep => Self::Keep,
            UvArg::Unwrap => Self::Unwrap,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum OutputArg {
    /// Irradiance at the flat normal
    E,
    /// Light vector
    G,
    /// Fluence
    Phi,
    /// Derivatives of the light vector per texel step
    Gradient,
    /// Estimated error of E
    Error,
    /// Tone-mapped picture of E
    Preview,
    /// The scene with the lightmap's texture coordinates
    Glb,
    /// Light vector and fluence as one KTX 2.0 texture: layers for red, green, blue; RGB = x, y, z, A = fluence
    Ktx2,
}

impl From<OutputArg> for Output {
    fn from(output: OutputArg) -> Self {
        match output {
            OutputArg::E => Self::E,
            OutputArg::G => Self::G,
            OutputArg::Phi => Self::Phi,
            OutputArg::Gradient => Self::Gradient,
            OutputArg::Error => Self::Error,
            OutputArg::Preview => Self::Preview,
            OutputArg::Glb => Self::Glb,
            OutputArg::Ktx2 => Self::Ktx2,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExportArg {
    /// Bakery's SH maps for Unity: L0, L1x, L1y, L1z
    BakerySh,
    /// Godot's directional lightmap, 4 slices one above the other
    GodotSh,
    /// Unity's directional mode: colour and direction
    UnityDirectional,
    /// Bevy's lightmap: E/pi
    Bevy,
}

impl From<ExportArg> for Export {
    fn from(export: ExportArg) -> Self {
        match export {
            ExportArg::BakerySh => Self::BakerySh,
            ExportArg::GodotSh => Self::GodotSh,
            ExportArg::UnityDirectional => Self::UnityDirectional,
            ExportArg::Bevy => Self::Bevy,
        }
    }
}

/// Reads the name of a table.
fn table() -> impl TypedValueParser<Value = Table> {
    PathBufValueParser::new().try_map(Table::new)
}

/// Reads a number in `range`; anything else, NaN too, is a message that states the range. Clap adds option and value.
pub(crate) fn real(range: RangeInclusive<f64>) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| match text.trim().parse::<f64>() {
        Ok(number) if range.contains(&number) => Ok(number),
        _ => Err(format!(
            "must be a number in {}..={}",
            range.start(),
            range.end()
        )),
    }
}

/// Reads a whole number in `range`.
pub(crate) fn whole(range: RangeInclusive<u32>) -> impl Fn(&str) -> Result<u32, String> + Clone {
    move |text| match text.trim().parse::<u32>() {
        Ok(number) if range.contains(&number) => Ok(number),
        _ => Err(format!(
            "must be a whole number in {}..={}",
            range.start(),
            range.end()
        )),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    fn bake_options(arguments: &[&str]) -> Options {
        let words = ["lumel", "bake", "a.glb"].iter().chain(arguments);
        match Args::try_parse_from(words).map(|args| args.command) {
            Ok(Command::Bake(bake)) => bake.options(),
            other => panic!("{arguments:?}: {other:?}"),
        }
    }

    #[test]
    fn the_definition_is_sound() {
        Args::command().debug_assert();
    }

    #[test]
    fn without_arguments_the_library_decides() {
        assert_eq!(bake_options(&[]), Options::default());
    }

    #[test]
    fn presets_are_what_their_help_says() {
        for preset in Preset::value_variants() {
            let value = preset.to_possible_value().expect("every preset has a name");
            let help = value
                .get_help()
                .expect("every preset has a help")
                .to_string();
            let words: Vec<&str> = help
                .split_whitespace()
                .skip_while(|word| !word.starts_with("--"))
                .collect();
            assert_eq!(words.len(), 6, "{help}");
            assert_eq!(
                bake_options(&["--preset", value.get_name()]),
                bake_options(&words),
                "{help}"
            );
        }
    }

    #[test]
    fn help_states_the_library_s_defaults() {
        let defaults = Options::default();
        let command = Args::command();
        let bake = command.find_subcommand("bake").expect("a subcommand");
        for (id, default) in [
            (
                "texels_per_metre",
                defaults.atlas.texels_per_metre.to_string(),
            ),
            ("page", defaults.atlas.page.to_string()),
            ("padding", defaults.atlas.padding.to_string()),
            ("tolerance", defaults.tolerance.to_string()),
            ("samples", defaults.transport.samples.to_string()),
            (
                "direct_certainty",
                defaults.transport.direct_certainty.to_string(),
            ),
            ("sky_lights", defaults.lights.sky_lights.to_string()),
            ("light_radius", defaults.lights.light_radius.to_string()),
            (
                "sun_angle",
                format!("{:.2}", defaults.lights.sun_angle.to_degrees()),
            ),
        ] {
            let argument = bake
                .get_arguments()
                .find(|argument| argument.get_id() == id);
            let help = argument
                .and_then(|argument| argument.get_help())
                .map(ToString::to_string)
                .unwrap_or_default();
            let [bare, explained] = [']', ','].map(|end| format!("[default: {default}{end}"));
            assert!(
                help.contains(&bare) || help.contains(&explained),
                "{id}: {help}"
            );
        }
    }

    #[test]
    fn the_ends_of_every_range_suit_the_library() {
        for (option, low, high) in [
            ("--texels-per-metre", "0.001", "10000"),
            ("--tolerance", "0.000001", "1"),
            ("--page", "64", "16384"),
            ("--padding", "2", "64"),
            ("--samples", "1", "65536"),
            ("--direct-threshold", "0", "1"),
            ("--direct-certainty", "0", "1"),
            ("--sky-lights", "1", "4096"),
            ("--light-radius", "0", "1000"),
            ("--sun-angle", "0", "90"),
        ] {
            for end in [low, high] {
                if let Err(error) = bake_options(&[option, end]).validate() {
                    panic!("{option} {end}: {error}");
                }
            }
        }
    }
}
