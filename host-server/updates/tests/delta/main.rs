//! Patches between images: what is made is what a robot makes, and what detools makes.

mod detools;
mod images;
mod patches;
mod releases;
