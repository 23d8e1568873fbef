//! The evidence: one file per kind, all in one binary.

mod browser;

mod support;

// Each stage keeps its promises.
mod atlas;
mod cli;
mod engine;
mod engine_schema;
mod engine_viewer;
mod estimators;
mod exact;
mod glass;
mod ktx2;
mod lights;
mod many_lights;
mod output;
mod punctual;
mod refine;
mod runtime;
mod scene;
mod sky;
mod sky_light;
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
