//! lumel bakes light into the textures of a glTF level, exactly where it can and with an error figure everywhere.
//!
//! At every texel it evaluates, per colour channel, the **light vector** `G = ∫ L ω dω`, which does not depend on the normal, the
//! **fluence** `φ = ∫ L dω`, and their spatial derivatives. An engine gets the irradiance of a bump-mapped normal `n` back as
//! `E(n) = max(0, G·n)`.
//!
//! # A walk through the program
//!
//! ```text
//! glTF ─► scene ─► atlas ─► texels ─┐
//!              ├─► lights ──────────┼─► transport ─► refine ─► output ─► files ─► runtime (in the engine)
//!              └─► visibility ──────┘
//! ```
//!
//! [`scene`] reads the file and settles every oddity in it. [`atlas`] gives each surface its place in the lightmap pages, and
//! [`texels`] says where in the world each texel lies. [`lights`] turns emissive surfaces into polygons, [`visibility`] answers what
//! stands between two points. [`transport`] evaluates the light at a point, [`refine`] decides at which points, [`output`] writes the
//! files, and [`runtime`] is what an engine needs to read them. [`bake`] joins the stages.
//!
//! # What is absent
//!
//! - After `scene` nobody knows glTF, except `output`, which writes it.
//! - `lights` and `visibility` do not know each other; they meet in `transport`.
//! - `refine` knows nothing of light: its samples come from a closure.
//! - Only `scene`, `output` and the command touch the disk; only the command prints.
//! - Threads, cancellation and progress never change a byte of the result.
//!
//! # Units
//!
//! Metres, radians, linear RGB (Rec. 709 primaries, as glTF). Radiance in nit, irradiance and fluence in lux, `J` in lux per metre.
//! Right-handed, Y up. Texture coordinates have v = 0 at the top row.

pub mod scene;

pub mod atlas;

pub mod texels;

pub mod lights;

pub mod visibility;

pub mod transport;

pub mod refine;

pub mod output;

pub mod runtime;

pub mod bake;

// Ground that every stage may stand on.

pub mod math;

pub mod error;

pub use error::{Error, Result};
