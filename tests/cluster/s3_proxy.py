"""Stands before an S3 server and fails as real ones do: `s3_proxy.py PORT HOST:PORT [options]`."""

import argparse
import http.client
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import count

BUSY = 503, "SlowDown", "Please reduce your request rate."
DENIED = 403, "AccessDenied", "Access Denied"
ERROR = '<?xml version="1.0" encoding="UTF-8"?><Error><Code>{}</Code><Message>{}</Message></Error>'
CHANGES = {"PUT", "POST", "DELETE"}
OWN = {"transfer-encoding", "connection", "expect", "content-length"}
"""Headers of one connection, not of the request or answer that it carries."""


class Proxy(BaseHTTPRequestHandler):
    """Hands requests on, but for those that it refuses; it prints a line for each of these."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def answer(self):
        body = self._body()
        number = next(self.server.numbers)
        if self.server.every and number % self.server.every == 0:
            self._refuse(*BUSY)
        elif self.server.read_only and self.command in CHANGES:
            self._refuse(*DENIED)
        else:
            self._hand_on(body)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = answer

    def _body(self):
        if self.headers.get("Transfer-Encoding", "").lower() != "chunked":
            return self.rfile.read(int(self.headers.get("Content-Length", 0)))
        found = b""
        while size := int(self.rfile.readline().split(b";")[0], 16):
            found += self.rfile.read(size)
            self.rfile.readline()
        self.rfile.readline()
        return found

    def _hand_on(self, body):
        server = http.client.HTTPConnection(self.server.behind, timeout=60)
        headers = {name: value for name, value in self.headers.items() if name.lower() not in OWN}
        headers["Content-Length"] = str(len(body))
        server.request(self.command, self.path, body or None, headers)
        answer = server.getresponse()
        content = answer.read()
        length = answer.getheader("Content-Length", "0") if self.command == "HEAD" else None
        self._send(answer.status, answer.getheaders(), content, length)
        server.close()

    def _refuse(self, status, code, message):
        print(status, self.command, self.path, flush=True)
        content = ERROR.format(code, message).encode()
        self._send(status, [("Content-Type", "application/xml")], content)

    def _send(self, status, headers, content, length=None):
        self.send_response_only(status)
        for name, value in headers:
            if name.lower() not in OWN:
                self.send_header(name, value)
        self.send_header("Content-Length", length or str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)


if __name__ == "__main__":
    given = argparse.ArgumentParser()
    given.add_argument("port", type=int)
    given.add_argument("behind")
    given.add_argument("--every", type=int, default=0, help="of so many requests, the last is 503")
    given.add_argument("--read-only", action="store_true", help="whatever would change it is 403")
    server = ThreadingHTTPServer(("127.0.0.1", 0), Proxy, bind_and_activate=False)
    for name, value in vars(given.parse_args()).items():
        setattr(server, name, value)
    server.server_address, server.numbers = ("127.0.0.1", server.port), count(1)
    server.server_bind()
    server.server_activate()
    server.serve_forever()
