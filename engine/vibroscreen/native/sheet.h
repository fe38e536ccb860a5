/* What a screen adds to the engine: resources/screen.bin, which vibroscreen_fmu/native/tables.py
   writes. Behind a head lie parts one after the other, each as a count and so many items. */
typedef struct {
    int32_t name, unit, range, cure, question, kind; /* places in the words */
} Variable;

typedef struct {
    char mark[8], engine[40];
    uint64_t size, checksum; /* of what follows */
} SheetHead;

typedef struct {
    const unsigned char *bytes, *at, *end;
    int64_t figures, dimensions, values, rows, units, variables, fixed, tunable, codes, reasons, texts, owners, words;
    const double *figure, *dimension, *start, *aperture, *velocity, *other_unit;
    const unsigned char *flags, *text_of_code, *text_of_reason, *owner;
    const Variable *variable;
    const int32_t *fixed_one, *tunable_one, *text;
    const char *word, *guid, *model; /* the first two words are guid and name of the model */
    int64_t starts, velocities;
} Sheet;

/* CRC-32 as zlib's, which goes on from that of what came before. */
static uint32_t checksum(uint32_t before, const void *bytes, size_t size) {
    uint32_t sum = ~before;
    for (const unsigned char *at = bytes; size--; at++) sum = sum >> 8 ^ CRC[(sum ^ *at) & 255];
    return ~sum;
}

/* The next part, and how many items of a size it has; the sheet ends before its end if it is cut. */
static const void *part(Sheet *sheet, size_t size, int64_t *count) {
    uint64_t n = 0, left = (uint64_t) (sheet->end - sheet->at);
    const unsigned char *items = sheet->at + sizeof n;
    *count = 0;
    if (left >= sizeof n) memcpy(&n, sheet->at, sizeof n);
    /* Items fill whole eights of bytes. */
    if (left < sizeof n || n > (left - sizeof n) / size || (n * size + 7) / 8 * 8 > left - sizeof n)
        return sheet->at = sheet->end, NULL;
    *count = (int64_t) n;
    sheet->at = items + (n * size + 7) / 8 * 8;
    return items;
}

/* Read a sheet for a GUID; NULL, or what is wrong with the file, which is closed. */
static const char *read_sheet(Sheet *sheet, FILE *file, const char *guid) {
    SheetHead head;
    *sheet = (Sheet) {.bytes = NULL};
    unsigned char *bytes = NULL;
    const char *wrong = "is cut or changed";
    if (!file) return "is missing";
    if (fread(&head, sizeof head, 1, file) != 1 || memcmp(head.mark, SHEET_MARK, sizeof head.mark)) goto closed;
    if (strncmp(head.engine, ENGINE, sizeof head.engine)) wrong = "is of another engine than this library";
    else if (head.size < 1u << 24 && (bytes = malloc(head.size + 1)) && fread(bytes, 1, head.size + 1, file) == head.size
             && checksum(0, bytes, head.size) == head.checksum)
        wrong = NULL;
closed:
    fclose(file);
    sheet->bytes = sheet->at = bytes;
    if (wrong) return wrong;
    sheet->end = bytes + head.size;
    sheet->figure = part(sheet, sizeof(double), &sheet->figures);
    sheet->dimension = part(sheet, sizeof(double), &sheet->dimensions);
    sheet->start = part(sheet, sizeof(double), &sheet->starts);
    sheet->aperture = part(sheet, sizeof(double), &sheet->rows);
    sheet->velocity = part(sheet, sizeof(double), &sheet->velocities);
    sheet->flags = part(sheet, 1, &sheet->values);
    sheet->other_unit = part(sheet, sizeof(double), &sheet->units);
    sheet->variable = part(sheet, sizeof(Variable), &sheet->variables);
    sheet->fixed_one = part(sheet, sizeof(int32_t), &sheet->fixed);
    sheet->tunable_one = part(sheet, sizeof(int32_t), &sheet->tunable);
    sheet->text_of_code = part(sheet, 1, &sheet->codes);
    sheet->text_of_reason = part(sheet, 1, &sheet->reasons);
    sheet->text = part(sheet, sizeof(int32_t), &sheet->texts);
    sheet->owner = part(sheet, 1, &sheet->owners);
    sheet->word = part(sheet, 1, &sheet->words);
    if (sheet->at != sheet->end || sheet->figures != FIGURES || sheet->dimensions != N_DIMENSIONS || sheet->owners != 16
        || sheet->variables != sheet->values || sheet->units != sheet->values || sheet->velocities != sheet->rows || sheet->texts < TEXTS
        || !sheet->words || sheet->word[sheet->words - 1])
        return "is cut or changed";
    sheet->guid = sheet->word;
    sheet->model = sheet->guid + strlen(sheet->guid) + 1;
    return guid && !strcmp(guid, sheet->guid) ? NULL : "is of another guid";
}
