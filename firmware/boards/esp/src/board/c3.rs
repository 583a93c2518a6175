//! XIAO ESP32C3: 4 MB flash, no lamp of its own.
//!
//! Source: Seeed Studio, schematic and pin list of XIAO ESP32C3. Strapping and USB pins: ESP32-C3
//! data sheet, sections "Strapping Pins" and "USB Serial/JTAG".

pin_table! {
    name: "XIAO ESP32C3",
    id: "xiao-c3",
    // Wired from 3.3 V through its resistor to the pin, which so is high at boot, as its strap
    // wants.
    lamp: lit Low,
    battery: GPIO3,
    divider: 100_000 over 33_000, converter ends at 2_500,
    strapping: [2, 8, 9],
    usb: [18, 19],
    console: [21],

    /// What hangs on the pins of the robot.
    RobotPins as robot {
        right_in2: "D0" = GPIO2, 2, "IN4 of the L298N";
        battery: "D1" = GPIO3, 3, "middle of the battery divider";
        left_in1: "D2" = GPIO4, 4, "IN1 of the L298N";
        left_in2: "D3" = GPIO5, 5, "IN2 of the L298N";
        left_enable: "D4" = GPIO6, 6, "ENA of the L298N";
        right_enable: "D5" = GPIO7, 7, "ENB of the L298N";
        ranger_tx: "D6" = GPIO21, 21, "Trig/TX of the US-100";
        ranger_rx: "D7" = GPIO20, 20, "Echo/RX of the US-100";
        lamp: "D8" = GPIO8, 8, "status lamp, to be added";
        button: "BOOT" = GPIO9, 9, "held at boot: provisioning; on the board";
        right_in1: "D10" = GPIO10, 10, "IN3 of the L298N";
    }
}
