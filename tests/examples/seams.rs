//! Seams of textures: `cargo run --release -p tests --example seams -- RESULT.lres…` prints the gradient of the albedo across borders
//! of charts, beside them, and their ratio.

use recordings::result::Estimate;
use std::error::Error;
use std::path::Path;
use tests::seams::measure;

fn main() -> Result<(), Box<dyn Error>> {
    println!("| result | border edges | across, 1/m | beside, 1/m | ratio |\n|---|---|---|---|---|");
    for path in std::env::args().skip(1) {
        let result = Estimate::read(Path::new(&path))?;
        match measure(&result)? {
            Some(s) => {
                let name = &result.name;
                println!("| {name} | {} | {:.2} | {:.2} | {:.2} |", s.edges, s.across, s.beside, s.ratio());
            }
            None => println!("| {} | no texture | | | |", result.name),
        }
    }
    Ok(())
}
