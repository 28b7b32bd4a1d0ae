/*
 * The app's own HTTP, for the examples: one request over plain HTTP, as to `veiloc serve` on this machine. An app uses
 * OkHttp, URLSession, UnityWebRequest or libcurl, with TLS.
 */
#ifndef EXAMPLE_HTTP_H
#define EXAMPLE_HTTP_H

#include <netdb.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

/* The body of a reply, freed by the caller. Returns the status, or 0 when there was no reply. `body` is null for GET. */
static int http_request(const char *host, const char *port, const char *path, const uint8_t *body, size_t length,
                        uint8_t **reply, size_t *reply_length) {
  struct addrinfo hints, *address = NULL;
  char head[512];
  uint8_t *all = NULL;
  size_t used = 0, capacity = 0;
  int status = 0, peer;
  *reply = NULL;
  *reply_length = 0;
  memset(&hints, 0, sizeof hints);
  hints.ai_socktype = SOCK_STREAM;
  if (getaddrinfo(host, port, &hints, &address) != 0) return 0;
  peer = socket(address->ai_family, address->ai_socktype, address->ai_protocol);
  if (peer < 0 || connect(peer, address->ai_addr, address->ai_addrlen) != 0) {
    if (peer >= 0) close(peer);
    freeaddrinfo(address);
    return 0;
  }
  freeaddrinfo(address);
  if (body) {
    snprintf(head, sizeof head,
             "POST %s HTTP/1.1\r\nHost: %s\r\nConnection: close\r\nContent-Type: application/x-protobuf\r\n"
             "Accept: application/x-protobuf\r\nContent-Length: %zu\r\n\r\n",
             path, host, length);
  } else {
    snprintf(head, sizeof head, "GET %s HTTP/1.1\r\nHost: %s\r\nConnection: close\r\n\r\n", path, host);
  }
  if (send(peer, head, strlen(head), 0) == (ssize_t)strlen(head)) {
    size_t sent = 0;
    ssize_t count = 1;
    while (body && sent < length && (count = send(peer, body + sent, length - sent, 0)) > 0) sent += (size_t)count;
    for (count = 1; count > 0;) {
      if (capacity - used < 65536) {
        uint8_t *larger = (uint8_t *)realloc(all, capacity += 65536);
        if (!larger) break;
        all = larger;
      }
      count = recv(peer, all + used, capacity - used, 0);
      if (count > 0) used += (size_t)count;
    }
  }
  close(peer);
  /* A status line, headers, an empty line; the service sends a length and never chunks of unknown number. */
  for (size_t i = 0; i + 4 <= used; i++) {
    if (memcmp(all + i, "\r\n\r\n", 4) == 0) {
      all[i] = 0;
      if (sscanf((const char *)all, "HTTP/1.1 %d", &status) != 1) status = 0;
      *reply_length = used - i - 4;
      memmove(all, all + i + 4, *reply_length);
      *reply = all;
      return status;
    }
  }
  free(all);
  return 0;
}

#endif
