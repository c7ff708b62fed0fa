// Mean of a pixel's samples in linear light. What a method does not know is -1, in the only sample that it then has.

override SAMPLES: u32 = 1;

// `first` is the layer of the first sample.
fn mean_of_samples(samples: texture_storage_2d_array<r32float, read>, pixel: vec2<u32>, first: u32) -> f32 {
    var sum = 0.0;
    for (var s = 0u; s < SAMPLES; s++) {
        sum += textureLoad(samples, pixel, first + s).r;
    }
    return sum * (1.0 / f32(SAMPLES));
}
