//! The evidence: one file per kind, all in one binary.

mod support;

// Each stage keeps its promises.
mod atlas;
mod cli;
mod estimators;
mod exact;
mod lights;
mod many_lights;
mod output;
mod punctual;
mod refine;
mod scene;
mod stiff;
mod texels;
mod traced;
mod transport;
mod vedel;
mod visibility;

// The whole.
mod architecture;
mod bake;
mod readers;

// Real levels, models and broken files by others.
mod corpus;
