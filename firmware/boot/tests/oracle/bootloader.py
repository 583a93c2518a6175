#!/usr/bin/env python3
"""Asks a shipped ESP32-C3 bootloader which slot it starts, for all states of both select entries.

The bootloader is the one in the crate espflash 4.7.0 (ESP-IDF release/v6.1, without rollback). Its routine
bootloader_utility_get_selected_boot_partition runs as it is, under the emulator unicorn; flash, ROM and
log are stubs. What it answers goes to standard output; it is kept beside this script as answers.txt, and
tests/boot/selection.rs holds the crate against it.

    python3 -m venv v && v/bin/pip install unicorn==2.1.4
    v/bin/python bootloader.py PATH/espflash-4.7.0/resources/bootloaders/esp32c3-bootloader.bin > answers.txt
"""

import hashlib
import struct
import sys
import zlib

from unicorn import UC_ARCH_RISCV, UC_HOOK_CODE, UC_MODE_RISCV32, Uc
from unicorn.riscv_const import (
    UC_RISCV_REG_A0,
    UC_RISCV_REG_A1,
    UC_RISCV_REG_A2,
    UC_RISCV_REG_PC,
    UC_RISCV_REG_RA,
    UC_RISCV_REG_SP,
)

SHA256 = "7c04141e1fd8da5a391e8004ffe3d8ee8e20eeb5baf9bd3abc05c03a17b1ed09"
# Found by disassembly, through the texts that the routine prints.
SELECT = 0x403CFBDE
MMAP = 0x403CF140
MUNMAP = 0x403CF208
TIMESTAMP = 0x403CEE7A
INITIAL_CONTENTS = 0x3FCD5710
# Functions of the ROM (esp32c3.rom.ld, esp32c3.rom.newlib.ld of ESP-IDF).
ROM_PRINTF = 0x40000040
ROM_MEMCPY = 0x40000358
ROM_CRC32_LE = 0x40000628
# Places that nothing else uses.
STACK = 0x3FCF0000
STATE = 0x3FCF4000
FLASH = 0x3C000000
DONE = 0x40050000
# The instruction c.jr ra.
RETURN = b"\x82\x80"
# Offset of the otadata partition and address of a slot: they are only compared with 0.
OTADATA = 0x9000

STATES = [0, 1, 2, 3, 4, 0xFFFFFFFF, 6]
SEQUENCES = [0, 1, 2, 3, 0xFFFFFFFE, 0xFFFFFFFF]


def entry(sequence, state, fits):
    crc = zlib.crc32(struct.pack("<I", sequence), 0xFFFFFFFF)
    return struct.pack("<I20sII", sequence, b"\xff" * 20, state, crc ^ (0 if fits else 0x10))


class Bootloader:
    def __init__(self, image):
        self.uc = Uc(UC_ARCH_RISCV, UC_MODE_RISCV32)
        for start, size in (
            (0x3FC80000, 0x80000),
            (0x403C0000, 0x20000),
            (0x40000000, 0x60000),
            (FLASH, 0x2000),
        ):
            self.uc.mem_map(start, size)
        at = 24
        for _ in range(image[1]):
            address, length = struct.unpack("<II", image[at : at + 8])
            self.uc.mem_write(address, image[at + 8 : at + 8 + length])
            at += 8 + length
        for stub in (MMAP, MUNMAP, TIMESTAMP, ROM_PRINTF, ROM_MEMCPY, ROM_CRC32_LE):
            self.uc.mem_write(stub, RETURN)
        self.calls = set()
        self.uc.hook_add(UC_HOOK_CODE, self.step)

    def step(self, uc, pc, _size, _data):
        def argument(register):
            return uc.reg_read(register)

        if pc == MMAP:
            assert argument(UC_RISCV_REG_A0) == OTADATA
            result = FLASH
        elif pc in (MUNMAP, TIMESTAMP, ROM_PRINTF):
            result = 0
        elif pc == ROM_MEMCPY:
            result = argument(UC_RISCV_REG_A0)
            length = argument(UC_RISCV_REG_A2)
            uc.mem_write(result, bytes(uc.mem_read(argument(UC_RISCV_REG_A1), length)))
        elif pc == ROM_CRC32_LE:
            data = uc.mem_read(argument(UC_RISCV_REG_A1), argument(UC_RISCV_REG_A2))
            result = zlib.crc32(bytes(data), argument(UC_RISCV_REG_A0))
        elif 0x40000000 <= pc < DONE:
            raise RuntimeError(f"an unknown function of the ROM at {pc:#x}")
        else:
            return
        self.calls.add(pc)
        uc.reg_write(UC_RISCV_REG_A0, result)

    def select(self, entries, slots):
        """The index of the slot, and whether the entries count as never written."""
        for sector, data in enumerate(entries):
            self.uc.mem_write(FLASH + 0x1000 * sector, data)
        # bootloader_state_t: otadata, factory, test, 16 slots (offset and size each), number of slots.
        places = struct.pack("<II", OTADATA, 0x2000) + bytes(16)
        for slot in range(16):
            used = slot < slots
            places += struct.pack("<II", 0x10000 * (slot + 1) * used, 0x10000 * used)
        self.uc.mem_write(STATE, places + struct.pack("<II", slots, 0))
        self.uc.mem_write(INITIAL_CONTENTS, b"\xaa")
        self.uc.reg_write(UC_RISCV_REG_A0, STATE)
        self.uc.reg_write(UC_RISCV_REG_SP, STACK)
        self.uc.reg_write(UC_RISCV_REG_RA, DONE)
        self.uc.emu_start(SELECT, DONE, count=100_000)
        assert self.uc.reg_read(UC_RISCV_REG_PC) == DONE
        (index,) = struct.unpack("<i", struct.pack("<I", self.uc.reg_read(UC_RISCV_REG_A0) & 0xFFFFFFFF))
        return index, self.uc.mem_read(INITIAL_CONTENTS, 1)[0]


def main():
    image = open(sys.argv[1], "rb").read()
    digest = hashlib.sha256(image).hexdigest()
    if digest != SHA256:
        sys.exit(f"another bootloader: SHA-256 {digest}")
    bootloader = Bootloader(image)
    print("# Answers of the ESP32-C3 bootloader of espflash 4.7.0; made by bootloader.py.")
    print("# Number of slots, both sequence numbers, CRC of each fits or not; then a letter for each pair of")
    print("# states: a digit is the slot, i is slot 0 with entries that were never written, - is none.")
    for slots in (2, 3):
        for first in SEQUENCES:
            for second in SEQUENCES:
                for fits in ((True, True), (True, False), (False, True), (False, False)):
                    line = ""
                    for state in STATES:
                        for other in STATES:
                            pair = entry(first, state, fits[0]), entry(second, other, fits[1])
                            index, initial = bootloader.select(pair, slots)
                            assert initial in (0, 1) and (index == 0 or not initial)
                            line += "i" if initial else "-" if index == -1 else str(index)
                    crc = "".join("+" if good else "x" for good in fits)
                    print(slots, f"{first:08x} {second:08x}", crc, line)
    assert {MMAP, MUNMAP, ROM_MEMCPY, ROM_CRC32_LE} <= bootloader.calls


main()
