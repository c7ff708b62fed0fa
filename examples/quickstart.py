"""A moving scene goes in, events come out."""

import evis

scene = evis.Scene.builtin("spinner")
sim = evis.Simulator(scene, size=(320, 240), rate_hz=500.0)
for packet in sim.stream(duration=0.05):
    on = int(packet.p.sum())
    print(f"{packet.start_us:6d} us: {len(packet.events)} events, {on} of them ON")
    print("        first pixels:", packet.x[:3], packet.y[:3], "at", packet.t[:3], "us")
