//! What an engine needs to read the maps.
