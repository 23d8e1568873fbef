//! Files: what is written is what is read, and nothing appears before all of it is there.

mod files;

mod container;

pub(crate) mod document;

pub(crate) mod glb;

pub(crate) mod maps;
