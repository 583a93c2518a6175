"""Makes the images and patches of this folder, with detools 0.53.0 (`pip install detools==0.53.0`).

    python3 make.py

The images are alike as two builds of a program are: most words repeat, addresses in the second have moved,
something was put in, something is gone, and two parts have changed places.
"""

import random
from io import BytesIO
from pathlib import Path

import detools

FOLDER = Path(__file__).parent


def program(words, first):
    """Machine code of a kind: the words, every fourth followed by an address."""
    code = b""
    for index, word in enumerate(words):
        code += word.to_bytes(4, "little")
        if index % 4 == 0:
            code += (first + 40 * index).to_bytes(4, "little")
    return code


def images():
    chance = random.Random(7305)
    vocabulary = [chance.getrandbits(32) for _ in range(60)]
    old = [chance.choice(vocabulary) for _ in range(800)]
    fresh = [chance.getrandbits(32) for _ in range(40)]
    new = old[:150] + fresh + old[500:700] + old[150:480] + old[700:] + fresh[:5]
    return program(old, 0x80001000), program(new, 0x80001A40)


def patch(old, new, window, length):
    out = BytesIO()
    detools.create_patch(
        BytesIO(old),
        BytesIO(new),
        out,
        compression="heatshrink",
        heatshrink_window_sz2=window,
        heatshrink_lookahead_sz2=length,
    )
    return out.getvalue()


def main():
    old, new = images()
    made = {
        "old.bin": old,
        "new.bin": new,
        "back.patch": patch(new, old, 10, 9),
        "from-nothing.patch": patch(b"", new, 10, 6),
        "to-nothing.patch": patch(old, b"", 8, 7),
        "same.patch": patch(old, old, 10, 9),
    }
    for window, length in [(4, 3), (8, 7), (10, 4), (10, 9)]:
        made[f"w{window}-l{length}.patch"] = patch(old, new, window, length)
    for name, content in made.items():
        (FOLDER / name).write_bytes(content)


main()
