// Phong lobes by Ceres, one texel after the other on one thread: what a user would write instead of `rigel fit --model phong2`.
//
//   g++ -O3 -march=native lobes.cpp -I/usr/include/eigen3 -lceres -lglog -o lobes     (Debian: libceres-dev)
//   lobes IN OUT LOBES
//
// IN: int32 texels, views; double directions (views x 3), measured (texels x views x 3), sigma (texels x views).
// OUT: double (texels x (3 + 7 LOBES)): Kd, then for each lobe m, Ks, r (unit vector). Prints CPU seconds per texel.
// Each further lobe begins where the residual of the fit before is largest, with three widths; all are then fitted together.
#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <vector>

static std::vector<double> directions;
static int views;

// Residuals and their derivatives in closed form: 3 per view, divided by sigma.
struct Lobes : ceres::CostFunction {
    const double *measured, *sigma;
    int lobes;
    Lobes(const double *measured, const double *sigma, int lobes) : measured(measured), sigma(sigma), lobes(lobes) {
        set_num_residuals(3 * views);
        mutable_parameter_block_sizes()->push_back(3 + 7 * lobes);
    }
    bool Evaluate(double const *const *blocks, double *residuals, double **jacobians) const override {
        const double *x = blocks[0];
        const int count = 3 + 7 * lobes;
        double *jacobian = jacobians ? jacobians[0] : nullptr;
        if (jacobian) std::fill(jacobian, jacobian + 3 * views * count, 0.0);
        for (int i = 0; i < views; i++) {
            const double *v = &directions[3 * i], weight = 1 / sigma[i];
            double sum[3] = {x[0], x[1], x[2]};
            for (int b = 0; b < lobes; b++) {
                const double *lobe = x + 3 + 7 * b, *ks = lobe + 1, *r = lobe + 4;
                const double length = std::sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
                const double unit[3] = {r[0] / length, r[1] / length, r[2] / length};
                const double cosine = v[0] * unit[0] + v[1] * unit[1] + v[2] * unit[2];
                if (cosine <= 1e-9) continue;
                const double log = std::log(cosine), power = std::exp(lobe[0] * log);
                for (int c = 0; c < 3; c++) {
                    sum[c] += ks[c] * power;
                    if (!jacobian) continue;
                    double *row = jacobian + count * (3 * i + c) + 3 + 7 * b;
                    row[0] = weight * ks[c] * power * log;
                    row[1 + c] = weight * power;
                    for (int d = 0; d < 3; d++)
                        row[4 + d] = weight * ks[c] * lobe[0] * power / cosine * (v[d] - cosine * unit[d]) / length;
                }
            }
            for (int c = 0; c < 3; c++) {
                residuals[3 * i + c] = weight * (sum[c] - measured[3 * i + c]);
                if (jacobian) jacobian[count * (3 * i + c) + c] = weight;
            }
        }
        return true;
    }
};

static double fit(const double *measured, const double *sigma, int lobes, double *x) {
    ceres::Problem problem;
    problem.AddResidualBlock(new Lobes(measured, sigma, lobes), nullptr, x);
    // Nothing is brighter than twice what was seen: without that, lobes between the views grow without end.
    const double most = 2 * *std::max_element(measured, measured + 3 * views);
    for (int c = 0; c < 3; c++) {
        problem.SetParameterLowerBound(x, c, 0);
        problem.SetParameterUpperBound(x, c, most);
    }
    for (int b = 0; b < lobes; b++) {
        const int at = 3 + 7 * b;
        problem.SetParameterLowerBound(x, at, 1);
        problem.SetParameterUpperBound(x, at, 5000);
        for (int c = 1; c < 4; c++) {
            problem.SetParameterLowerBound(x, at + c, 0);
            problem.SetParameterUpperBound(x, at + c, most);
        }
        for (int d = 4; d < 7; d++) {
            problem.SetParameterLowerBound(x, at + d, d == 6 ? 0 : -1);
            problem.SetParameterUpperBound(x, at + d, 1);
        }
    }
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.max_num_iterations = 200;
    options.function_tolerance = 1e-8;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.final_cost;
}

int main(int count, char **words) {
    FILE *in = count == 4 ? std::fopen(words[1], "rb") : nullptr;
    int32_t size[2];
    if (!in || std::fread(size, 4, 2, in) != 2) return std::fprintf(stderr, "lobes IN OUT LOBES\n"), 1;
    const int texels = size[0], lobes = std::atoi(words[3]), parameters = 3 + 7 * lobes;
    views = size[1];
    directions.resize(3 * views);
    std::vector<double> measured(3L * texels * views), sigma(1L * texels * views), found(1L * texels * parameters);
    for (auto *part : {&directions, &measured, &sigma})
        if (std::fread(part->data(), 8, part->size(), in) != part->size()) return std::fprintf(stderr, "a short file\n"), 1;
    const std::clock_t start = std::clock();
    for (int t = 0; t < texels; t++) {
        const double *o = &measured[3L * t * views], *s = &sigma[1L * t * views];
        std::vector<double> best(parameters, 0.0);
        for (int i = 0; i < views; i++)
            for (int c = 0; c < 3; c++) best[c] += 0.8 * o[3 * i + c] / views;
        for (int b = 0; b < lobes; b++) {
            int peak = 0;
            double highest = -1e300;
            for (int i = 0; i < views; i++) {
                double rest = 0;
                for (int c = 0; c < 3; c++) rest += o[3 * i + c] - best[c];
                for (int k = 0; k < b; k++) {
                    const double *lobe = &best[3 + 7 * k], *v = &directions[3 * i];
                    const double cosine = v[0] * lobe[4] + v[1] * lobe[5] + v[2] * lobe[6];
                    if (cosine > 0) rest -= (lobe[1] + lobe[2] + lobe[3]) * std::pow(cosine, lobe[0]);
                }
                if (rest > highest) highest = rest, peak = i;
            }
            double least = 1e300;
            std::vector<double> before = best;
            for (double shininess : {5.0, 30.0, 150.0}) {
                std::vector<double> x = before;
                double *lobe = &x[3 + 7 * b];
                lobe[0] = shininess;
                for (int c = 0; c < 3; c++) lobe[1 + c] = 0.1, lobe[4 + c] = directions[3 * peak + c];
                const double cost = fit(o, s, b + 1, x.data());
                for (int k = 0; k <= b; k++) {
                    double *r = &x[7 + 7 * k], length = std::sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
                    for (int d = 0; d < 3; d++) r[d] /= length;
                }
                if (cost < least) least = cost, best = x;
            }
        }
        std::copy(best.begin(), best.end(), found.begin() + 1L * t * parameters);
    }
    std::printf("%.9f\n", double(std::clock() - start) / CLOCKS_PER_SEC / texels);
    FILE *out = std::fopen(words[2], "wb");
    return !out || std::fwrite(found.data(), 8, found.size(), out) != found.size() || std::fclose(out) != 0;
}
