/* Where this library lies, what lies beside it, and what a host means by a resource location.

   Paths are UTF-8. What is made here is freed by who asked for it; NULL where there is nothing. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>

static wchar_t *wide(const char *path) {
    int n = MultiByteToWideChar(CP_UTF8, 0, path, -1, NULL, 0);
    wchar_t *made = n > 0 ? malloc((size_t) n * sizeof *made) : NULL;
    if (made) MultiByteToWideChar(CP_UTF8, 0, path, -1, made, n);
    return made;
}

static FILE *open_file(const char *path) {
    wchar_t *name = wide(path);
    FILE *file = name ? _wfopen(name, L"rb") : NULL;
    free(name);
    return file;
}

static void *load(const char *path) {
    wchar_t *name = wide(path);
    HMODULE library = name ? LoadLibraryW(name) : NULL;
    free(name);
    return library;
}

static void *find(void *library, const char *name) { return (void *) (uintptr_t) GetProcAddress(library, name); }

static void unload(void *library) { FreeLibrary(library); }

static char *own_path(void) {
    enum { ROOM = 1 << 15 };
    HMODULE module = NULL;
    wchar_t *name = malloc(ROOM * sizeof *name);
    char *path = NULL;
    DWORD length = 0, how = GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_UNCHANGED_REFCOUNT;
    if (name && GetModuleHandleExW(how, (LPCWSTR) (uintptr_t) own_path, &module))
        length = GetModuleFileNameW(module, name, ROOM);
    int n = length && length < ROOM ? WideCharToMultiByte(CP_UTF8, 0, name, -1, NULL, 0, NULL, NULL) : 0;
    if (n > 0 && (path = malloc((size_t) n))) WideCharToMultiByte(CP_UTF8, 0, name, -1, path, n, NULL, NULL);
    free(name);
    for (char *at = path; at && *at; at++)
        if (*at == '\\') *at = '/';
    return path;
}
#else
#include <dlfcn.h>

static FILE *open_file(const char *path) { return fopen(path, "rb"); }

static void *load(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }

static void *find(void *library, const char *name) { return dlsym(library, name); }

static void unload(void *library) { dlclose(library); }

static char *own_path(void) {
    Dl_info found;
    return dladdr((void *) (uintptr_t) own_path, &found) && found.dli_fname ? realpath(found.dli_fname, NULL) : NULL;
}
#endif

/* The path `rest` in the folder so many levels above this library: 0 for its own folder. */
static char *beside(int levels, const char *rest) {
    char *path = own_path(), *end, *made = NULL;
    while (path && (end = strrchr(path, '/'))) {
        *end = 0;
        if (levels--) continue;
        made = malloc(strlen(path) + strlen(rest) + 2);
        if (made) sprintf(made, "%s/%s", path, rest);
        break;
    }
    free(path);
    return made;
}

static int digit_of(char c) {
    const char *digits = "0123456789abcdef0123456789ABCDEF", *at = c ? strchr(digits, c) : NULL;
    return at ? (int) (at - digits) % 16 : -1;
}

/* The path `rest` in the folder that a host names, by a URI of the scheme "file" or as it is. */
static char *located(const char *folder, const char *rest) {
    if (!folder || !*folder) return NULL;
    char *made = malloc(strlen(folder) + strlen(rest) + 2), *to = made;
    if (!made) return NULL;
    int uri = !strncmp(folder, "file:", 5) || !strncmp(folder, "FILE:", 5);
    if (uri) {
        folder += 5;
        if (!strncmp(folder, "//localhost/", 12)) folder += 11;
        else if (!strncmp(folder, "///", 3) || (!strncmp(folder, "//", 2) && folder[2] && folder[3] == ':')) folder += 2;
#ifdef _WIN32
        if (folder[0] == '/' && folder[1] && folder[2] == ':') folder++;
#endif
    }
    for (; *folder; folder++) {
        int high = uri && *folder == '%' ? digit_of(folder[1]) : -1, low = high < 0 ? -1 : digit_of(folder[2]);
        if (low < 0) *to++ = *folder;
        else *to++ = (char) (16 * high + low), folder += 2;
    }
    while (to > made && to[-1] == '/') to--;
    sprintf(to, "/%s", rest);
    return made;
}
