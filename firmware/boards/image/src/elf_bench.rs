//! Small ELF files for tests, laid out by hand.

/// `EM_RISCV`.
pub(crate) const RISCV: u16 = 243;
/// `EM_XTENSA`.
pub(crate) const XTENSA: u16 = 94;

/// Flags `SHF_ALLOC`, `SHF_WRITE`, `SHF_EXECINSTR`.
pub(crate) const ALLOC: u32 = 2;
pub(crate) const WRITE: u32 = 1;
pub(crate) const EXECUTE: u32 = 4;

/// One section: name, address, flags, bytes, or a size without bytes.
pub(crate) struct Section {
    pub(crate) name: &'static str,
    pub(crate) address: u32,
    pub(crate) flags: u32,
    pub(crate) data: Data,
}

/// What a section holds.
pub(crate) enum Data {
    /// `SHT_PROGBITS`.
    Bytes(Vec<u8>),
    /// `SHT_NOBITS`.
    Zeros(u32),
}

/// A section with bytes.
pub(crate) fn bytes(name: &'static str, address: u32, flags: u32, data: Vec<u8>) -> Section {
    Section {
        name,
        address,
        flags: flags | ALLOC,
        data: Data::Bytes(data),
    }
}

/// A section that takes memory but nothing in the file.
pub(crate) fn zeros(name: &'static str, address: u32, flags: u32, size: u32) -> Section {
    Section {
        name,
        address,
        flags: flags | ALLOC,
        data: Data::Zeros(size),
    }
}

/// An executable ELF32, little endian.
pub(crate) fn elf(machine: u16, sections: &[Section]) -> Vec<u8> {
    const HEADER: usize = 52;
    let mut names = vec![0];
    let mut body = vec![0; HEADER];
    // sh_name, sh_type, sh_flags, sh_addr, sh_offset, sh_size, then four zeros.
    let mut table: Vec<[u32; 6]> = vec![[0; 6]];
    let mut name_of = |name: &str| {
        let at = names.len() as u32;
        names.extend_from_slice(name.as_bytes());
        names.push(0);
        at
    };
    for section in sections {
        let name = name_of(section.name);
        body.resize(body.len().next_multiple_of(4), 0);
        let offset = body.len() as u32;
        let (kind, size) = match &section.data {
            Data::Bytes(data) => {
                body.extend_from_slice(data);
                (1, data.len() as u32)
            }
            Data::Zeros(size) => (8, *size),
        };
        table.push([name, kind, section.flags, section.address, offset, size]);
    }
    let name = name_of(".shstrtab");
    table.push([name, 3, 0, 0, body.len() as u32, names.len() as u32]);
    body.extend_from_slice(&names);
    body.resize(body.len().next_multiple_of(4), 0);
    let table_at = body.len() as u32;
    for row in &table {
        for value in row.iter().chain(&[0, 0, 1, 0]) {
            body.extend_from_slice(&value.to_le_bytes());
        }
    }
    let entry = sections.first().map_or(0, |first| first.address);
    let mut head = vec![0x7f, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    head.extend_from_slice(&2_u16.to_le_bytes());
    head.extend_from_slice(&machine.to_le_bytes());
    for value in [1, entry, 0, table_at, 0] {
        head.extend_from_slice(&value.to_le_bytes());
    }
    for value in [
        HEADER as u16,
        0,
        0,
        40,
        table.len() as u16,
        table.len() as u16 - 1,
    ] {
        head.extend_from_slice(&value.to_le_bytes());
    }
    body[..HEADER].copy_from_slice(&head);
    body
}
