defmodule Aerie.Console.ProxyTest do
  use Aerie.ConsoleCase, async: true

  import ExUnit.CaptureLog
  import Aerie.HTTPClient

  @https [{"x-forwarded-proto", "https"}, {"x-forwarded-for", "203.0.113.7"}]

  test "behind a proxy of ours the session is for TLS only, and each client has its own tries" do
    [console: console] = start_console(config: %{http: %{port: 0, proxies: ["127.0.0.1"]}})
    signed = sign_in(console, "operator", password(:operator), @https)
    assert signed.status == 303
    assert signed.cookie =~ "Secure"
    refute get(console, "/sign-in", %{}, @https).body =~ "TLS"

    for _try <- 1..5, do: sign_in(console, "operator", "not-the-password", @https)
    assert sign_in(console, "operator", password(:operator), @https).status == 429
    other = [{"x-forwarded-proto", "https"}, {"x-forwarded-for", "203.0.113.8"}]
    assert sign_in(console, "operator", password(:operator), other).status == 303

    # The client came to the proxy without TLS.
    plain = [{"x-forwarded-proto", "http"}, {"x-forwarded-for", "203.0.113.9"}]
    refute sign_in(console, "operator", password(:operator), plain).cookie =~ "Secure"
    assert get(console, "/sign-in", %{}, plain).body =~ "This connection has no TLS"
  end

  test "an unknown proxy is not believed, and not silently" do
    log =
      capture_log(fn ->
        [console: console] = start_console()
        refute sign_in(console, "operator", password(:operator), @https).cookie =~ "Secure"
        assert get(console, "/sign-in", %{}, @https).body =~ "Add the proxy"
        refute get(console, "/sign-in").body =~ "TLS"
      end)

    assert log =~ "127.0.0.1 forwards requests"
    assert log =~ "http.proxies"
  end

  test "without a key a forwarded request is nobody's of this machine" do
    [console: console] = start_console(config: %{http: %{port: 0, proxies: ["127.0.0.1"]}})

    for headers <- [@https, [{"x-forwarded-proto", "https"}], [{"x-forwarded-for", "127.0.0.1"}]],
        do: assert(get(console, "/api/status", %{}, headers).status == 403)
  end
end
