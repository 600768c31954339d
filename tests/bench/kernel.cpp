// The arithmetic of photoreg.search.kernels.population_costs for two photos, as a plain C++
// loop: the yardstick of the compiled Python. Same order of work, same buffers, same
// trimming by buckets; nothing tuned by hand. It samples the photos' validity too, which
// the other does only where there is a mask: in one vector with the colours it is free,
// and without it this loop was slower.
//
// Build: g++ -O3 -march=native -std=c++17 -shared -fPIC -pthread kernel.cpp

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <thread>
#include <vector>

namespace {

// The buffers never overlap, and the compiler may know it: without this the C++ loop took
// 1.9 times as long.
using In = const float* __restrict;
using Out = float* __restrict;

constexpr int kBuckets = 2048;
constexpr int kShift = 20;
constexpr double kMaxGain = 2.0;
constexpr double kLeastSpread = 1e-3;

struct Problem {
    const float* points;        // (7, n): x, y, z, normal x, y, z, normal . position
    const float* projections;   // (p, 2, 3, 4)
    const float* centers;       // (p, 2, 3)
    const uint8_t* allowed;     // (2, n)
    const float* pixels;        // (total, 4)
    const int64_t* layouts;     // (2, 3): first row, width, height
    int64_t n;
    int64_t n_individuals;
    float squared_cosine;
    double low_share;
    double high_share;
    bool with_exposure;
    double reference_spread;    // above 0 only with exposure
    int64_t min_samples;
    double* costs;              // (p,)
    int64_t* kept;              // (p,)
};

struct Scratch {
    std::vector<float> u, v, colours, values, border;
    std::vector<uint8_t> seen;
    std::vector<int32_t> index, counts;

    explicit Scratch(int64_t n)
        : u(2 * n), v(2 * n), colours(8 * n), values(n), border(n + 1), seen(2 * n),
          index(n + 1), counts(kBuckets) {}
};

void project(const Problem& problem, In P, In center, int photo, Out u, Out v,
             uint8_t* __restrict seen) {
    const int64_t n = problem.n;
    In xs = problem.points;
    In ys = xs + n;
    In zs = xs + 2 * n;
    In nxs = xs + 3 * n;
    In nys = xs + 4 * n;
    In nzs = xs + 5 * n;
    In nds = xs + 6 * n;
    const uint8_t* __restrict allowed = problem.allowed + photo * n;
    const float right = float(problem.layouts[3 * photo + 1] - 1);
    const float bottom = float(problem.layouts[3 * photo + 2] - 1);
    const float cx = center[0], cy = center[1], cz = center[2];
    for (int64_t k = 0; k < n; ++k) {
        const float x = xs[k], y = ys[k], z = zs[k];
        const float depth = P[8] * x + P[9] * y + P[10] * z + P[11];
        const float inverse = 1.0f / depth;
        const float pixel_x = (P[0] * x + P[1] * y + P[2] * z + P[3]) * inverse;
        const float pixel_y = (P[4] * x + P[5] * y + P[6] * z + P[7]) * inverse;
        const float d = nxs[k] * cx + nys[k] * cy + nzs[k] * cz - nds[k];
        const float dx = cx - x, dy = cy - y, dz = cz - z;
        u[k] = pixel_x;
        v[k] = pixel_y;
        seen[k] = (depth > 0.0f) & (d >= 0.0f) &
                  (d * d >= problem.squared_cosine * (dx * dx + dy * dy + dz * dz)) &
                  (pixel_x >= 0.0f) & (pixel_x <= right) & (pixel_y >= 0.0f) &
                  (pixel_y <= bottom) & (allowed[k] != 0);
    }
}

int64_t list_seen(const uint8_t* first, const uint8_t* second, int64_t n,
                  int32_t* __restrict index) {
    int64_t found = 0;
    for (int64_t k = 0; k < n; ++k) {
        index[found] = int32_t(k);
        found += first[k] & second[k];
    }
    return found;
}

void sample(const Problem& problem, int photo, In u, In v,
            const int32_t* __restrict index, int64_t n, Out colours) {
    const int64_t offset = problem.layouts[3 * photo];
    const int64_t width = problem.layouts[3 * photo + 1];
    const int64_t height = problem.layouts[3 * photo + 2];
    for (int64_t k = 0; k < n; ++k) {
        const float x = u[index[k]], y = v[index[k]];
        const int64_t column = std::min(int64_t(x), width - 2);
        const int64_t row = std::min(int64_t(y), height - 2);
        const float fx = x - float(column), fy = y - float(row);
        const float* at = problem.pixels + 4 * (offset + row * width + column);
        const float* below = at + 4 * width;
        const float w11 = fx * fy;
        const float w01 = fx - w11, w10 = fy - w11;
        const float w00 = 1.0f - fx - w10;
        for (int c = 0; c < 4; ++c)
            colours[4 * k + c] =
                w00 * at[c] + w01 * at[4 + c] + w10 * below[c] + w11 * below[4 + c];
    }
}

double clipped_gain(double wanted, double own) {
    if (own <= 0.0) return 1.0;
    return std::min(std::max(std::sqrt(wanted / own), 1.0 / kMaxGain), kMaxGain);
}

double pair_exposure(In a, In b, int64_t n, float gains[2][4], float offsets[2][4]) {
    double total = 0.0;
    for (int c = 0; c < 3; ++c) {
        double sum_a = 0, sum_b = 0, square_a = 0, square_b = 0;
        for (int64_t k = 0; k < n; ++k) {
            const double x = a[4 * k + c], y = b[4 * k + c];
            sum_a += x;
            sum_b += y;
            square_a += x * x;
            square_b += y * y;
        }
        const double mean_a = sum_a / n, mean_b = sum_b / n;
        const double spread_a = std::max(square_a / n - mean_a * mean_a, 0.0);
        const double spread_b = std::max(square_b / n - mean_b * mean_b, 0.0);
        const double common = 0.5 * (spread_a + spread_b);
        total += common;
        const double mean = 0.5 * (mean_a + mean_b);
        const double gain_a = clipped_gain(common, spread_a);
        const double gain_b = clipped_gain(common, spread_b);
        gains[0][c] = float(gain_a);
        gains[1][c] = float(gain_b);
        offsets[0][c] = float(mean - gain_a * mean_a);
        offsets[1][c] = float(mean - gain_b * mean_b);
    }
    return total;
}

void differences(In a, In b, int64_t n, const float gains[2][4],
                 const float offsets[2][4], float* values) {
    const float c0 = offsets[0][0] - offsets[1][0];
    const float c1 = offsets[0][1] - offsets[1][1];
    const float c2 = offsets[0][2] - offsets[1][2];
    for (int64_t k = 0; k < n; ++k) {
        const float x = gains[0][0] * a[4 * k] - gains[1][0] * b[4 * k] + c0;
        const float y = gains[0][1] * a[4 * k + 1] - gains[1][1] * b[4 * k + 1] + c1;
        const float z = gains[0][2] * a[4 * k + 2] - gains[1][2] * b[4 * k + 2] + c2;
        values[k] = x * x + y * y + z * z;
    }
}

uint32_t bits_of(float value) {
    uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

int64_t gather(In values, int64_t n, uint32_t bucket, float* border) {
    int64_t found = 0;
    for (int64_t k = 0; k < n; ++k) {
        border[found] = values[k];
        found += (bits_of(values[k]) >> kShift) == bucket;
    }
    std::sort(border, border + found);
    return found;
}

double trimmed_mean(In values, int64_t n, int64_t n_low, int64_t n_high,
                    int32_t* counts, float* border) {
    const int64_t n_kept = n - n_low - n_high;
    if (n_kept <= 0) return std::numeric_limits<double>::infinity();
    double total = 0.0;
    if (n_low == 0 && n_high == 0) {
        for (int64_t k = 0; k < n; ++k) total += values[k];
        return total / n_kept;
    }
    std::fill(counts, counts + kBuckets, 0);
    for (int64_t k = 0; k < n; ++k) ++counts[bits_of(values[k]) >> kShift];
    const int64_t last_rank = n - n_high - 1;
    int64_t bucket = 0, below = 0;
    while (below + counts[bucket] <= n_low) below += counts[bucket++];
    const int64_t low_bucket = bucket, low_below = below;
    while (below + counts[bucket] <= last_rank) below += counts[bucket++];
    const int64_t high_bucket = bucket, high_below = below;
    const uint32_t after_low = uint32_t(low_bucket + 1) << kShift;
    const uint32_t from_high = uint32_t(high_bucket) << kShift;
    if (high_bucket > low_bucket + 1)
        for (int64_t k = 0; k < n; ++k) {
            const uint32_t bits = bits_of(values[k]);
            total += (bits >= after_low) & (bits < from_high) ? values[k] : 0.0f;
        }
    int64_t n_border = gather(values, n, uint32_t(low_bucket), border);
    const int64_t end = high_bucket > low_bucket ? n_border : last_rank + 1 - low_below;
    for (int64_t k = n_low - low_below; k < end; ++k) total += border[k];
    if (high_bucket > low_bucket) {
        gather(values, n, uint32_t(high_bucket), border);
        for (int64_t k = 0; k < last_rank + 1 - high_below; ++k) total += border[k];
    }
    return total / n_kept;
}

void work(const Problem& problem, int64_t first, int64_t step) {
    const int64_t n = problem.n;
    Scratch scratch(n);
    float gains[2][4] = {{1, 1, 1, 1}, {1, 1, 1, 1}};
    float offsets[2][4] = {{0, 0, 0, 0}, {0, 0, 0, 0}};
    for (int64_t i = first; i < problem.n_individuals; i += step) {
        for (int photo = 0; photo < 2; ++photo)
            project(problem, problem.projections + 24 * i + 12 * photo,
                    problem.centers + 6 * i + 3 * photo, photo,
                    scratch.u.data() + photo * n, scratch.v.data() + photo * n,
                    scratch.seen.data() + photo * n);
        const int64_t n_seen = list_seen(scratch.seen.data(), scratch.seen.data() + n, n,
                                         scratch.index.data());
        for (int photo = 0; photo < 2; ++photo)
            sample(problem, photo, scratch.u.data() + photo * n,
                   scratch.v.data() + photo * n, scratch.index.data(), n_seen,
                   scratch.colours.data() + 4 * photo * n);
        problem.kept[i] = n_seen;
        problem.costs[i] = std::numeric_limits<double>::infinity();
        if (n_seen < problem.min_samples) continue;
        In a = scratch.colours.data();
        In b = a + 4 * n;
        double spread = 0.0;
        if (problem.with_exposure) spread = pair_exposure(a, b, n_seen, gains, offsets);
        differences(a, b, n_seen, gains, offsets, scratch.values.data());
        problem.costs[i] = trimmed_mean(
            scratch.values.data(), n_seen, int64_t(problem.low_share * n_seen),
            int64_t(problem.high_share * n_seen), scratch.counts.data(),
            scratch.border.data());
        if (problem.reference_spread > 0.0)
            problem.costs[i] *=
                problem.reference_spread /
                std::max(spread, kLeastSpread * problem.reference_spread);
    }
}

}  // namespace

extern "C" void population_costs(const float* points, const float* projections,
                                 const float* centers, const uint8_t* allowed,
                                 const float* pixels, const int64_t* layouts, int64_t n,
                                 int64_t n_individuals, double min_cosine,
                                 double low_share, double high_share,
                                 int with_exposure, double reference_spread,
                                 int64_t min_samples,
                                 int64_t n_threads, double* costs, int64_t* kept) {
    const Problem problem{points,
                          projections,
                          centers,
                          allowed,
                          pixels,
                          layouts,
                          n,
                          n_individuals,
                          float(min_cosine * min_cosine),
                          low_share,
                          high_share,
                          with_exposure != 0,
                          reference_spread,
                          min_samples,
                          costs,
                          kept};
    if (n_threads == 1) {
        work(problem, 0, 1);
        return;
    }
    std::vector<std::thread> threads;
    for (int64_t t = 0; t < n_threads; ++t)
        threads.emplace_back(work, std::cref(problem), t, n_threads);
    for (std::thread& thread : threads) thread.join();
}
