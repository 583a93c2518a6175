mod access_point;
mod connections;
mod fallback;
mod harness;
mod page;
mod parsers;
mod requests;
