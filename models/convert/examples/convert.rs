//! Converts a file: `convert MODEL.onnx MODEL.tcmm`.

use std::process::ExitCode;
use std::{env, fs};

use crawler_convert::{Options, convert};
use crawler_micromodel::Model;

fn run() -> Result<String, String> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [from, to] = &arguments[..] else {
        return Err("usage: convert MODEL.onnx MODEL.tcmm".to_owned());
    };
    let onnx = fs::read(from).map_err(|error| format!("{from}: {error}"))?;
    let blob = convert(&onnx, &Options::default()).map_err(|error| format!("{from}: {error}"))?;
    let model = Model::new(&blob).map_err(|error| error.to_string())?;
    fs::write(to, &blob).map_err(|error| format!("{to}: {error}"))?;
    Ok(format!(
        "{to}: {} bytes, an arena of {}, {} multiplications a run",
        model.bytes(),
        model.arena_bytes(),
        model.multiplications()
    ))
}

fn main() -> ExitCode {
    match run() {
        Ok(told) => {
            println!("{told}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
