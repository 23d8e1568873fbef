"""Reads OpenEXR files with the reference library and dumps their samples.

For each file given, writes FILE.openexr.raw: all channels (R, G, B or Y), one
after the other, rows from the top down, in the type they have in the file.
Prints one JSON object per file.
"""

import json
import sys

import OpenEXR

for path in sys.argv[1:]:
    with OpenEXR.File(path, separate_channels=True) as file:
        header = file.header()
        channels = file.channels()
        names = [name for name in ("R", "G", "B", "Y") if name in channels]
        with open(path + ".openexr.raw", "wb") as raw:
            for name in names:
                raw.write(channels[name].pixels.tobytes())
        first = channels[names[0]].pixels
        print(
            json.dumps(
                {
                    "parts": len(file.parts),
                    "width": first.shape[1],
                    "height": first.shape[0],
                    "type": str(first.dtype),
                    "channels": sorted(channels),
                    "compression": str(header["compression"]),
                    "lumel": header.get("lumel"),
                }
            )
        )
