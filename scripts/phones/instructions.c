/*
 * Counts the instructions that a program executes under qemu-user, by function: a plugin for qemu 7 or newer.
 *
 *     gcc -shared -fPIC -O2 instructions.c -o instructions.so
 *     qemu-aarch64 -plugin ./instructions.so PROGRAM ...
 *
 * Prints `COUNT SYMBOL` for each function to stderr when the program ends, and the sum as `COUNT total`. Functions without a
 * symbol are `?`. Counts are exact for programs of one thread. scripts/phones/measure.py uses it.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The part of qemu-plugin.h that is used: Debian's qemu-user has no header. */
typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
enum qemu_plugin_op { QEMU_PLUGIN_INLINE_ADD_U64 };
extern void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t, void (*)(qemu_plugin_id_t, struct qemu_plugin_tb *));
extern size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
extern struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
extern const char *qemu_plugin_insn_symbol(const struct qemu_plugin_insn *);
extern void qemu_plugin_register_vcpu_insn_exec_inline(struct qemu_plugin_insn *, enum qemu_plugin_op, void *, uint64_t);
extern void qemu_plugin_register_atexit_cb(qemu_plugin_id_t, void (*)(qemu_plugin_id_t, void *), void *);
extern void qemu_plugin_outs(const char *);

__attribute__((visibility("default"))) int qemu_plugin_version = 1;

enum { SLOTS = 1 << 16 };
struct function {
  const char *symbol;
  uint64_t count;
};
static struct function functions[SLOTS];

/* The slot of a symbol, by its text: qemu may give one symbol at several addresses. */
static struct function *slot(const char *symbol) {
  uint32_t at = 2166136261u;
  for (const char *c = symbol; *c; c++) at = (at ^ (uint8_t)*c) * 16777619u;
  for (at %= SLOTS;; at = (at + 1) % SLOTS) {
    if (!functions[at].symbol) functions[at].symbol = strdup(symbol);
    if (!strcmp(functions[at].symbol, symbol)) return &functions[at];
  }
}

static void translated(qemu_plugin_id_t id, struct qemu_plugin_tb *block) {
  (void)id;
  /* One addition for each run of instructions of one function. */
  size_t count = qemu_plugin_tb_n_insns(block);
  for (size_t first = 0, next; first < count; first = next) {
    struct qemu_plugin_insn *insn = qemu_plugin_tb_get_insn(block, first);
    const char *symbol = qemu_plugin_insn_symbol(insn);
    struct function *function = slot(symbol ? symbol : "?");
    for (next = first + 1; next < count; next++) {
      const char *other = qemu_plugin_insn_symbol(qemu_plugin_tb_get_insn(block, next));
      if (strcmp(other ? other : "?", function->symbol)) break;
    }
    qemu_plugin_register_vcpu_insn_exec_inline(insn, QEMU_PLUGIN_INLINE_ADD_U64, &function->count, next - first);
  }
}

static void ended(qemu_plugin_id_t id, void *unused) {
  (void)id, (void)unused;
  uint64_t sum = 0;
  for (int i = 0; i < SLOTS; i++) {
    if (functions[i].count) fprintf(stderr, "%llu %s\n", (unsigned long long)functions[i].count, functions[i].symbol);
    sum += functions[i].count;
  }
  fprintf(stderr, "%llu total\n", (unsigned long long)sum);
}

__attribute__((visibility("default"))) int qemu_plugin_install(qemu_plugin_id_t id, const void *info, int argc, char **argv) {
  (void)info, (void)argc, (void)argv;
  qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
  qemu_plugin_register_atexit_cb(id, ended, NULL);
  return 0;
}
