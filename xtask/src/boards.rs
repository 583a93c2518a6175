//! The boards: what each is built from, and where the results lie.

use std::path::PathBuf;

use crate::run::{self, Failure, Outcome};

/// One board, as `--board NAME` names it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Board {
    /// What it is called; for an ESP32 also the name of its chip and its cargo feature.
    pub(crate) name: &'static str,
    /// Its workspace, below `firmware/boards`.
    pub(crate) workspace: &'static str,
    /// Its program.
    pub(crate) binary: &'static str,
    /// What rustc calls its processor.
    pub(crate) triple: &'static str,
    /// The parts of std that its program needs.
    pub(crate) std: &'static str,
    /// Its flash, for a board that is flashed.
    pub(crate) flash: Option<Flash>,
}

/// Flash of a board.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Flash {
    /// As `crawler-image` and `espflash` write it, in lower case.
    pub(crate) size: &'static str,
    /// Partition table, below `firmware/boards`.
    pub(crate) partitions: &'static str,
}

const SMALL: Flash = Flash {
    size: "4mb",
    partitions: "partitions.csv",
};

/// The robot in QEMU.
pub(crate) const VIRT: Board = Board {
    name: "virt",
    workspace: "virt",
    binary: "crawler-virt",
    triple: "riscv32imac-unknown-none-elf",
    std: "core",
    flash: None,
};
/// What starts the robot in QEMU from one of its slots.
pub(crate) const BOOT_STAGE: Board = Board {
    name: "virt-boot",
    binary: "crawler-virt-boot",
    ..VIRT
};
/// The robot program without any board, which is weighed and never run.
pub(crate) const PROGRAM: Board = Board {
    name: "program",
    workspace: "footprint",
    binary: "crawler-footprint",
    ..VIRT
};
/// XIAO ESP32-C3.
pub(crate) const C3: Board = Board {
    name: "esp32c3",
    workspace: "esp",
    binary: "crawler-esp",
    triple: "riscv32imc-unknown-none-elf",
    std: "core,alloc",
    flash: Some(SMALL),
};
/// XIAO ESP32-C6.
pub(crate) const C6: Board = Board {
    name: "esp32c6",
    triple: "riscv32imac-unknown-none-elf",
    ..C3
};
/// XIAO ESP32-S3 Sense.
pub(crate) const S3: Board = Board {
    name: "esp32s3",
    triple: "xtensa-esp32s3-none-elf",
    flash: Some(Flash {
        size: "8mb",
        partitions: "partitions-8mb.csv",
    }),
    ..C3
};

/// Every board that can be asked for.
pub(crate) const ALL: [&Board; 4] = [&VIRT, &C3, &C6, &S3];

/// Workspaces below `firmware/boards`.
pub(crate) const WORKSPACES: [&str; 5] = ["esp", "footprint", "image", "log", "virt"];

/// The manifest of one of them, from the root of the repository.
pub(crate) fn manifest(workspace: &str) -> String {
    format!("firmware/boards/{workspace}/Cargo.toml")
}

/// Where all of them are built: what two have in common, as std and procedural macros, is built once.
pub(crate) fn target_dir() -> PathBuf {
    run::target_dir().join("boards")
}

/// Where the workspaces of the boards lie.
pub(crate) fn folder() -> PathBuf {
    run::root().join("firmware/boards")
}

impl Board {
    /// The board called `name`.
    ///
    /// # Errors
    /// Lists the names there are.
    pub(crate) fn named(name: &str) -> Outcome<&'static Self> {
        ALL.into_iter()
            .find(|board| board.name == name)
            .ok_or_else(|| {
                let names = ALL.map(|board| board.name).join(", ");
                Failure(format!("there is no board '{name}': {names}"))
            })
    }

    /// The folder of its workspace.
    pub(crate) fn folder(&self) -> PathBuf {
        folder().join(self.workspace)
    }

    /// The program `binary` of its workspace, once built.
    pub(crate) fn elf(&self, binary: &str) -> PathBuf {
        target_dir().join(self.triple).join("release").join(binary)
    }

    /// Bootloader, partition table and program, to be written from address 0.
    pub(crate) fn merged_image(&self) -> PathBuf {
        run::target_dir()
            .join("images")
            .join(format!("{}.bin", self.name))
    }

    /// The program with release keys in it.
    pub(crate) fn keyed_elf(&self) -> PathBuf {
        run::target_dir()
            .join("images")
            .join(format!("{}.elf", self.name))
    }

    /// The program alone, for one update slot.
    pub(crate) fn update_image(&self) -> PathBuf {
        run::target_dir()
            .join("images")
            .join(format!("{}-update.bin", self.name))
    }

    /// Arguments that choose this board among those of its workspace.
    pub(crate) fn features(&self) -> Vec<&'static str> {
        if self.flash.is_some() {
            vec!["--no-default-features", "--features", self.name]
        } else {
            Vec::new()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{ALL, Board};

    #[test]
    fn boards_are_found_by_name() {
        for board in ALL {
            assert_eq!(Board::named(board.name).expect("found"), board);
        }
        let error = Board::named("esp32").expect_err("unknown").0;
        assert!(error.contains("virt, esp32c3, esp32c6, esp32s3"), "{error}");
    }

    #[test]
    fn no_two_boards_write_the_same_file() {
        for one in ALL {
            for other in ALL {
                if one != other {
                    assert_ne!(one.elf(one.binary), other.elf(other.binary));
                    assert_ne!(one.merged_image(), other.update_image());
                }
            }
        }
    }
}
