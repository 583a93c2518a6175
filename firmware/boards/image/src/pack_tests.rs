use std::path::Path;

use espflash::flasher::FlashSize;
use espflash::target::Chip;
use sha2::{Digest as _, Sha256};

use super::{Target, chip, pack};
use crate::app_image;
use crate::elf_bench::{EXECUTE, RISCV, Section, WRITE, XTENSA, bytes, elf, zeros};

fn target(chip: Chip) -> Target<'static> {
    Target {
        chip,
        flash: FlashSize::_4Mb,
        partitions: Path::new("../partitions.csv"),
    }
}

/// `esp_app_desc_t`: 256 bytes behind its magic word.
fn descriptor() -> Vec<u8> {
    let mut bytes = 0xabcd_5432_u32.to_le_bytes().to_vec();
    bytes.resize(256, 0);
    bytes
}

/// A program whose code is `code` bytes long, at the addresses of an ESP32-C3.
fn program(code: usize) -> Vec<Section> {
    vec![
        bytes(".text", 0x4201_0020, EXECUTE, vec![0x13; code]),
        bytes(".flash.appdesc", 0x3c00_0020, 0, descriptor()),
        bytes(".rodata", 0x3c00_0120, 0, vec![7; 1000]),
        bytes(".data", 0x3fc8_0000, WRITE, vec![3; 500]),
        zeros(".bss", 0x3fc8_1000, WRITE, 4000),
    ]
}

fn refused(elf: &[u8], target: &Target<'_>, because: &str) {
    let error = pack(elf, target).expect_err(because).0;
    assert!(error.contains(because), "{error}");
}

#[test]
fn an_elf_becomes_a_flash_that_starts() {
    let images = pack(&elf(RISCV, &program(5000)), &target(Chip::Esp32c3)).expect("image");
    let image = app_image::read(&images.update).expect("readable");
    assert_eq!(image.entry, 0x4201_0020);
    assert_eq!(image.chip, 5, "the C3's id in esp_chip_id_t");
    assert!(image.payload >= 5000 + 1256 + 500);
    // Bootloader at 0, table at 0x8000, blank otadata and settings, program in ota_0.
    assert_eq!(images.merged[0], 0xe9);
    assert_eq!(images.merged[0x8000..0x8002], [0xaa, 0x50]);
    assert!(
        images.merged[0x9000..0x1_0000]
            .iter()
            .all(|byte| *byte == 0xff)
    );
    assert_eq!(images.merged[0x1_0000..], images.update);
}

#[test]
fn the_bootloader_is_told_the_size_of_the_flash() {
    for (flash, code, partitions) in [
        (FlashSize::_4Mb, 2, "../partitions.csv"),
        (FlashSize::_8Mb, 3, "../partitions-8mb.csv"),
    ] {
        let target = Target {
            chip: Chip::Esp32c6,
            flash,
            partitions: Path::new(partitions),
        };
        let elf = elf(
            RISCV,
            &[bytes(".flash.appdesc", 0x4200_0020, 0, descriptor())],
        );
        let images = pack(&elf, &target).expect("image");
        assert_eq!(images.merged[3] >> 4, code);
    }
}

#[test]
fn a_program_larger_than_its_slot_is_refused() {
    refused(
        &elf(RISCV, &program(0x1e_0000)),
        &target(Chip::Esp32c3),
        "espflash cannot make an image of it",
    );
}

#[test]
fn a_program_for_another_processor_is_refused() {
    refused(
        &elf(XTENSA, &program(100)),
        &target(Chip::Esp32c3),
        "an ELF for Xtensa, but esp32c3 is Riscv32",
    );
    refused(
        &elf(RISCV, &program(100)),
        &target(Chip::Esp32s3),
        "but esp32s3 is Xtensa",
    );
}

#[test]
fn a_program_without_descriptor_is_refused() {
    let sections: Vec<_> = program(100)
        .into_iter()
        .filter(|section| section.name != ".flash.appdesc")
        .collect();
    refused(
        &elf(RISCV, &sections),
        &target(Chip::Esp32c3),
        "esp_app_desc!()",
    );
}

#[test]
fn noise_is_refused() {
    let whole = elf(RISCV, &program(100));
    for bytes in [&[][..], b"hello", &whole[..40], &whole[..whole.len() - 200]] {
        assert!(pack(bytes, &target(Chip::Esp32c3)).is_err());
    }
    // A descriptor shorter than it says makes espflash index past its end.
    let short = elf(
        RISCV,
        &[bytes(".flash.appdesc", 0x3c00_0020, 0, vec![1; 16])],
    );
    refused(&short, &target(Chip::Esp32c3), "espflash gave up");
}

#[test]
fn a_build_id_is_that_of_the_elf_file() {
    let elf = elf(RISCV, &program(300));
    let images = pack(&elf, &target(Chip::Esp32c3)).expect("image");
    let hash = Sha256::digest(&elf);
    let first: &[u8; 8] = hash.first_chunk().expect("longer");
    let expected = format!("{:016x}", u64::from_be_bytes(*first));
    assert_eq!(app_image::build(&images.update), Ok(expected));
    assert!(app_image::build(&images.update[..170]).is_err());
    assert!(app_image::build(&[0; 300]).is_err());
}

#[test]
fn an_image_with_a_flipped_bit_is_found_out() {
    let images = pack(&elf(RISCV, &program(300)), &target(Chip::Esp32c3)).expect("image");
    // Every byte that structure, checksum or hash covers: all of them.
    for at in (0..images.update.len()).step_by(97) {
        let mut image = images.update.clone();
        image[at] ^= 0x10;
        assert!(app_image::read(&image).is_err(), "byte {at}");
    }
    for length in [0, 23, 24, 1000, images.update.len() - 1] {
        assert!(app_image::read(&images.update[..length]).is_err());
    }
}

#[test]
fn the_chips_of_this_project_have_names() {
    for name in ["esp32s3", "esp32c3", "esp32c6"] {
        assert_eq!(chip(name).expect(name).to_string(), name);
    }
    assert!(chip("esp32").is_err());
}
