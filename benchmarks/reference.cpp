// The best hand-written Q-learning loops known to us, as the bar for curricle's engine.
//
//   reference W1 ties|cached|naive float32|float64 STEPS TABLES
//   reference W2 ties|cached|naive float32         STEPS
//
// prints {"ns_per_step": ..., "greedy_return": ...}: processor time of the loop alone, and the
// discounted return of the greedy policy it ends with. Learning rate 0.1, epsilon 0.1, episodes
// cut at a time limit that bootstraps. One SplitMix64 draw a step: its upper half decides whether
// to explore, its lower half names the action. `ties` does what curricle does: among actions of the
// same value each is equally likely at every visit (drawn a visit ahead, off the chain from state to
// state). In the others ties go to the first action met, which costs less but learns FrozenLake's
// 8x8 not at all, for instance.
//
// W1, a deterministic maze of 4 actions, read from TABLES (cpp.py writes them). Tried, in
// nanoseconds of an otherwise idle 2.8 GHz Xeon, float32:
//   8.1  cached row maximum, separate arrays of next state, reward and end
//   7.4  one struct a pair; the best pair's index kept in place of the action
//   5.7  and nothing written where nothing changes (most steps, once learnt)     = cached
//   5.9  and the choice to explore a conditional move; 5.7 with the start as a final pair's
//        successor; 6.0 with a conditional move in place of the branch at an episode's end
//   5.0  and the greedy successor kept by each state, which takes a load off the chain from state
//        to state: only where moves are deterministic
// W2, two predators hunting a prey on a walled 7x7 grid, 25 joint actions, sizes known to the
// compiler, successors computed. Tried, float32:
//   100  maximum of a row by a scalar loop;  66  by vectors of 256 bits;  59  of 512 bits
//    59  best value and action in one struct;  71  rows padded to whole cache lines
//    79  a bound on the second best kept, to scan less often (it then scans twice)
//    41  the next row fetched ahead
//    37  and the tables on huge pages, as NumPy's are                            = cached
#include <sys/mman.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>
#include <vector>
#if defined(__AVX512F__) || defined(__BMI2__)
#include <immintrin.h>
#endif

namespace {

constexpr double kLearningRate = 0.1;
constexpr uint32_t kExplore = 429496729;  // 0.1 * 2^32

inline uint64_t draw(uint64_t& state) {  // SplitMix64
  uint64_t z = (state += 0x9E3779B97F4A7C15ull);
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

inline bool explores(uint64_t bits) { return uint32_t(bits >> 32) < kExplore; }
inline uint32_t below(uint64_t bits, uint32_t n) { return ((bits & 0xffffffff) * n) >> 32; }

double processor_seconds() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return double(t.tv_sec) + 1e-9 * double(t.tv_nsec);
}

struct Measured {
  double ns_per_step, greedy_return;
};

template <class F, uint32_t n>
inline uint32_t first_best(const F* row) {
  uint32_t best = 0;
  for (uint32_t i = 1; i < n; i++)
    if (row[i] > row[best]) best = i;
  return best;
}

// A random one of the bits that are set.
inline uint32_t pick(uint32_t mask, uint64_t bits) {
  uint32_t n = below(bits * 0xD1342543DE82EF95ull, __builtin_popcount(mask));
#ifdef __BMI2__
  return __builtin_ctz(_pdep_u32(1u << n, mask));
#else
  for (; n > 0; n--) mask &= mask - 1;
  return __builtin_ctz(mask);
#endif
}

[[noreturn]] void fail(const std::string& message) {
  std::fprintf(stderr, "%s\n", message.c_str());
  std::exit(1);
}

template <class T>
std::vector<T> read(std::FILE* file, size_t count) {
  std::vector<T> values(count);
  if (std::fread(values.data(), sizeof(T), count, file) != count) fail("the file is too short");
  return values;
}

std::FILE* open(const char* path) {
  std::FILE* file = std::fopen(path, "rb");
  if (!file) fail(std::string("cannot open ") + path);
  return file;
}

// -- W1 ------------------------------------------------------------------------------------------

struct Maze {
  static constexpr uint32_t kActions = 4;
  uint32_t states, start, limit;
  double discount;
  std::vector<int32_t> next;      // (S, A)
  std::vector<double> reward;     // (S, A)
  std::vector<uint8_t> terminal;  // (S,)

  explicit Maze(const char* path) {
    std::FILE* file = open(path);
    const auto head = read<int32_t>(file, 4);
    states = head[0], start = head[2], limit = head[3];
    if (head[1] != int(kActions)) fail("W1 has four actions");
    discount = read<double>(file, 1)[0];
    next = read<int32_t>(file, states * kActions);
    reward = read<double>(file, states * kActions);
    terminal = read<uint8_t>(file, states);
    std::fclose(file);
  }

  template <class F>
  double greedy_return(const F* q) const {
    double total = 0, weight = 1;
    uint32_t state = start;
    for (uint32_t i = 0; i < limit && !terminal[state]; i++, weight *= discount) {
      const uint32_t pair = state * kActions + first_best<F, kActions>(q + state * kActions);
      total += weight * reward[pair];
      state = next[pair];
    }
    return total;
  }
};

template <class F>
struct Pair {
  uint32_t next;
  F reward;
  bool ends;
};

template <class F>
std::vector<Pair<F>> pairs_of(const Maze& maze) {
  std::vector<Pair<F>> pairs;
  for (size_t k = 0; k < maze.next.size(); k++)
    pairs.push_back({uint32_t(maze.next[k]), F(maze.reward[k]), bool(maze.terminal[maze.next[k]])});
  return pairs;
}

// Actions of the highest value, a bit each.
template <class F>
inline uint32_t best_four(const F* row, F& best) {
  best = std::max(std::max(row[0], row[1]), std::max(row[2], row[3]));
  return (row[0] == best) | (row[1] == best) << 1 | (row[2] == best) << 2 | (row[3] == best) << 3;
}

// A pair's number is doubled, and odd where it was drawn among several.
template <class F>
Measured maze_with_ties(const Maze& maze, long steps) {
  constexpr uint32_t A = Maze::kActions;
  struct Best {
    F value;
    uint32_t pair;
  };
  const auto pairs = pairs_of<F>(maze);
  std::vector<F> table(maze.states * A, 0);
  std::vector<Best> bests(maze.states);
  uint64_t stream = 7;
  for (uint32_t s = 0; s < maze.states; s++) bests[s] = {0, (s * A + below(draw(stream), A)) * 2 + 1};
  F* __restrict q = table.data();
  Best* __restrict best = bests.data();
  const Pair<F>* __restrict pair_of = pairs.data();

  const F alpha = F(kLearningRate), gamma = F(maze.discount);
  stream = 42;
  uint32_t state = maze.start, left = maze.limit;
  const double begin = processor_seconds();
  for (long i = 0; i < steps; i++) {
    const uint64_t bits = draw(stream);
    const uint32_t k = explores(bits) ? state * A + below(bits, A) : best[state].pair >> 1;
    const uint32_t next = pair_of[k].next;
    const bool ends = pair_of[k].ends;
    F target = pair_of[k].reward;
    if (!ends) target += gamma * best[next].value;
    const F before = q[k], after = before + alpha * (target - before), value = best[state].value;
    const bool changed = after != before;
    if (changed) q[k] = after;
    if (after > value) {
      best[state] = {after, k * 2};
    } else if (changed ? before == value || after == value : best[state].pair == k * 2 + 1) {
      F found;
      const uint32_t mask = best_four(q + state * A, found);
      best[state] = {found, (state * A + pick(mask, bits)) * 2 + ((mask & (mask - 1)) != 0)};
    }
    state = next;
    if (ends || --left == 0) state = maze.start, left = maze.limit;
  }
  return {(processor_seconds() - begin) / double(steps) * 1e9, maze.greedy_return(q)};
}

template <class F>
Measured maze_cached(const Maze& maze, long steps) {
  constexpr uint32_t A = Maze::kActions;
  struct Best {
    F value;
    uint32_t pair;
  };
  const auto pairs = pairs_of<F>(maze);
  std::vector<F> table(maze.states * A, 0);
  std::vector<Best> bests(maze.states);
  for (uint32_t s = 0; s < maze.states; s++) bests[s] = {0, s * A};
  F* __restrict q = table.data();
  Best* __restrict best = bests.data();
  const Pair<F>* __restrict pair_of = pairs.data();

  const F alpha = F(kLearningRate), gamma = F(maze.discount);
  uint64_t stream = 42;
  uint32_t state = maze.start, left = maze.limit;
  const double begin = processor_seconds();
  for (long i = 0; i < steps; i++) {
    const uint64_t bits = draw(stream);
    const uint32_t k = explores(bits) ? state * A + below(bits, A) : best[state].pair;
    const uint32_t next = pair_of[k].next;
    const bool ends = pair_of[k].ends;
    F target = pair_of[k].reward;
    if (!ends) target += gamma * best[next].value;
    const F before = q[k], after = before + alpha * (target - before), value = best[state].value;
    if (after != before) {
      q[k] = after;
      if (after > value) {
        best[state] = {after, k};
      } else if (before == value) {  // the best entry fell, or one that ties with it
        const uint32_t found = state * A + first_best<F, A>(q + state * A);
        best[state] = {q[found], found};
      }
    }
    state = next;
    if (ends || --left == 0) state = maze.start, left = maze.limit;
  }
  return {(processor_seconds() - begin) / double(steps) * 1e9, maze.greedy_return(q)};
}

// What a careful first version does: looks through a row to act and through one to bootstrap.
template <class F>
Measured maze_naive(const Maze& maze, long steps) {
  constexpr uint32_t A = Maze::kActions;
  const auto pairs = pairs_of<F>(maze);
  std::vector<F> table(maze.states * A, 0);
  F* __restrict q = table.data();
  const Pair<F>* __restrict pair_of = pairs.data();

  const F alpha = F(kLearningRate), gamma = F(maze.discount);
  uint64_t stream = 42;
  uint32_t state = maze.start, left = maze.limit;
  const double begin = processor_seconds();
  for (long i = 0; i < steps; i++) {
    const uint64_t bits = draw(stream);
    const uint32_t a = explores(bits) ? below(bits, A) : first_best<F, A>(q + state * A);
    const Pair<F>& pair = pair_of[state * A + a];
    F target = pair.reward;
    if (!pair.ends) {
      const F* row = q + pair.next * A;
      target += gamma * std::max(std::max(row[0], row[1]), std::max(row[2], row[3]));
    }
    F& entry = q[state * A + a];
    entry += alpha * (target - entry);
    state = pair.next;
    if (pair.ends || --left == 0) state = maze.start, left = maze.limit;
  }
  return {(processor_seconds() - begin) / double(steps) * 1e9, maze.greedy_return(q)};
}

// -- W2 ------------------------------------------------------------------------------------------

constexpr uint32_t kSide = 7, kCells = kSide * kSide, kMoves = 5, kJoint = kMoves * kMoves;
constexpr uint32_t kStates = kCells * kCells * kCells, kLimit = 200;
constexpr double kDiscount = 0.95;

// Joint actions of the highest value, a bit each. Two vectors that cover a row overlap.
inline uint32_t best_joint(const float* row, float& best) {
#ifdef __AVX512F__
  const __m512 low = _mm512_loadu_ps(row), high = _mm512_loadu_ps(row + kJoint - 16);
  best = _mm512_reduce_max_ps(_mm512_max_ps(low, high));
  const __m512 all = _mm512_set1_ps(best);
  return uint32_t(_mm512_cmpeq_ps_mask(low, all)) |
         uint32_t(_mm512_cmpeq_ps_mask(high, all)) << (kJoint - 16);
#else
  best = row[0];
  for (uint32_t i = 1; i < kJoint; i++) best = std::max(best, row[i]);
  uint32_t mask = 0;
  for (uint32_t i = 0; i < kJoint; i++) mask |= uint32_t(row[i] == best) << i;
  return mask;
#endif
}

struct Landing {
  uint8_t cell[kCells][kMoves];
  constexpr Landing() : cell() {
    constexpr int steps[kMoves][2] = {{0, 0}, {-1, 0}, {0, 1}, {1, 0}, {0, -1}};
    for (int c = 0; c < int(kCells); c++)
      for (int m = 0; m < int(kMoves); m++) {
        const int row = c / int(kSide) + steps[m][0], column = c % int(kSide) + steps[m][1];
        const bool inside = row >= 0 && row < int(kSide) && column >= 0 && column < int(kSide);
        cell[c][m] = inside ? row * kSide + column : c;
      }
  }
};
constexpr Landing kLanding;

struct Hunt {
  uint32_t prey, first, second;
  uint64_t stream;

  bool caught() const { return first == prey && second == prey; }
  uint32_t state() const { return (prey * kCells + first) * kCells + second; }

  void reset() {
    do {
      const uint32_t state = below(draw(stream) >> 32, kStates);
      prey = state / (kCells * kCells), first = state / kCells % kCells, second = state % kCells;
    } while (caught());
  }

  // One draw names the action and, by what the multiplication leaves over, the prey's move.
  inline void move(uint32_t action, uint32_t prey_move) {
    const uint32_t one = action / kMoves;
    prey = kLanding.cell[prey][prey_move];
    first = kLanding.cell[first][one];
    second = kLanding.cell[second][action - kMoves * one];
  }
};

double hunt_return(const float* q, Hunt hunt) {
  constexpr int episodes = 10000;
  double total = 0;
  hunt.stream = 7;
  for (int episode = 0; episode < episodes; episode++) {
    hunt.reset();
    double weight = 1;
    for (uint32_t i = 0; i < kLimit; i++, weight *= kDiscount) {
      const uint32_t action = first_best<float, kJoint>(q + size_t(hunt.state()) * kJoint);
      hunt.move(action, below(draw(hunt.stream), kMoves));
      if (hunt.caught()) break;
      total -= weight;
    }
  }
  return total / episodes;
}

template <class T>
T* zeroed(size_t count) {
  constexpr size_t page = 1 << 21;
  const size_t bytes = (count * sizeof(T) + page) / page * page;
  void* memory = std::aligned_alloc(page, bytes);
  if (!memory) fail("out of memory");
  madvise(memory, bytes, MADV_HUGEPAGE);
  return static_cast<T*>(std::memset(memory, 0, bytes));
}

enum Variant { kNaive, kCached, kTies };
constexpr uint8_t kTied = 128;  // drawn among several

template <Variant variant>
Measured hunt_prey(long steps) {
  Hunt hunt{};
  float* __restrict q = zeroed<float>(size_t(kStates) * kJoint);
  float* __restrict best = zeroed<float>(kStates);
  uint8_t* __restrict arg = zeroed<uint8_t>(kStates);
  if (variant == kTies) {
    hunt.stream = 7;
    for (uint32_t s = 0; s < kStates; s++) arg[s] = kTied | below(draw(hunt.stream), kJoint);
  }
  const float alpha = float(kLearningRate), gamma = float(kDiscount);
  hunt.stream = 42;
  hunt.reset();
  uint32_t state = hunt.state(), left = kLimit;
  const double begin = processor_seconds();
  for (long i = 0; i < steps; i++) {
    const uint64_t bits = draw(hunt.stream), scaled = (bits & 0xffffffff) * kJoint;
    float* row = q + size_t(state) * kJoint;
    float unused, following;
    uint32_t greedy = arg[state] & (kTied - 1);
    if (variant == kNaive) greedy = __builtin_ctz(best_joint(row, unused));
    const uint32_t action = explores(bits) ? uint32_t(scaled >> 32) : greedy;
    hunt.move(action, below(scaled, kMoves));
    const uint32_t next = hunt.state();
    const float* next_row = q + size_t(next) * kJoint;
    if (variant == kNaive) {
      best_joint(next_row, following);
    } else {  // its first, middle and last entry: two or three cache lines
      for (uint32_t entry : {0u, kJoint / 2, kJoint - 1}) __builtin_prefetch(next_row + entry);
      following = best[next];
    }
    const bool ends = hunt.caught();
    const float target = ends ? 0.0f : -1.0f + gamma * following;
    const float before = row[action], after = before + alpha * (target - before);
    row[action] = after;
    if (variant != kNaive) {
      const bool changed = after != before, top = before == best[state];
      if (after > best[state]) {
        best[state] = after;
        arg[state] = uint8_t(action);
      } else if (top && (changed || (variant == kTies && arg[state] == (action | kTied)))) {
        const uint32_t mask = best_joint(row, best[state]);
        if (variant == kTies)
          arg[state] = uint8_t(pick(mask, bits) | (mask & (mask - 1) ? kTied : 0));
        else
          arg[state] = uint8_t(__builtin_ctz(mask));
      }
    }
    state = next;
    if (__builtin_expect(ends || --left == 0, 0)) {
      hunt.reset();
      state = hunt.state(), left = kLimit;
    }
  }
  const double ns = (processor_seconds() - begin) / double(steps) * 1e9;
  return {ns, hunt_return(q, hunt)};
}

template <class F>
Measured measure(const std::string& task, const std::string& variant, long steps, const char* path) {
  if (task == "W1" && path) {
    const Maze maze(path);
    if (variant == "ties") return maze_with_ties<F>(maze, steps);
    if (variant == "cached") return maze_cached<F>(maze, steps);
    if (variant == "naive") return maze_naive<F>(maze, steps);
  }
  if (task == "W2" && sizeof(F) == sizeof(float)) {
    if (variant == "ties") return hunt_prey<kTies>(steps);
    if (variant == "cached") return hunt_prey<kCached>(steps);
    if (variant == "naive") return hunt_prey<kNaive>(steps);
  }
  fail("no such task and variant, or no tables: " + task + " " + variant);
}

}  // namespace

int main(int count, char** words) {
  if (count < 5) fail("usage: reference TASK VARIANT DTYPE STEPS [TABLES]");
  const long steps = std::atol(words[4]);
  const char* path = count > 5 ? words[5] : nullptr;
  const bool single = std::string(words[3]) == "float32";
  const Measured m = single ? measure<float>(words[1], words[2], steps, path)
                            : measure<double>(words[1], words[2], steps, path);
  std::printf("{\"ns_per_step\": %.4f, \"greedy_return\": %.6f}\n", m.ns_per_step, m.greedy_return);
}
