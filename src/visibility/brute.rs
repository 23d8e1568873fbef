//! stub

/// stub
#[derive(Debug)]
pub struct BruteForce;
