defmodule Aerie.Console.Access.CompressionTest do
  use Aerie.ConsoleCase, async: true

  import Aerie.HTTPClient

  @gzip [{"accept-encoding", "gzip, deflate, br, zstd"}]

  setup do
    [console: console] = start_console()
    for n <- 1..12, do: put_vehicle(console, "VID-#{n}", [], %{key: {"main", n}, system_id: n})
    %{console: console, jar: sign_in(console, "operator", password(:operator)).jar}
  end

  test "pages, JSON and metrics are compressed for those who accept it", %{console: console, jar: jar} do
    for {path, type, there} <- [
          {"/", "text/html", "</html>"},
          {"/vehicles/VID-1", "text/html", "</html>"},
          {"/plan", "text/html", "</html>"},
          {"/sign-in", "text/html", "</html>"},
          {"/api", "application/json", "/api/vehicles"},
          {"/api/vehicles", "application/json", "VID-12"},
          {"/metrics", "text/plain", "gateway_vehicles"}
        ] do
      plain = get(console, path, jar)
      packed = get(console, path, jar, @gzip)
      assert {path, plain.status, packed.status} == {path, 200, 200}
      assert packed.headers["content-type"] =~ type
      refute is_map_key(plain.headers, "content-encoding")
      assert packed.headers["content-encoding"] == "gzip"
      assert packed.headers["content-length"] == "#{byte_size(packed.body)}"
      for answer <- [plain, packed], do: assert(answer.headers["vary"] =~ "accept-encoding")
      assert plain.body =~ there and :zlib.gunzip(packed.body) =~ there
      # JSON and HTML repeat themselves.
      assert byte_size(packed.body) * 2 < byte_size(plain.body)
    end
  end

  test "what is small stays as it is", %{console: console} do
    small = get(console, "/healthz", %{}, @gzip)
    assert small.body == ~s({"status":"ok"})
    refute is_map_key(small.headers, "content-encoding")
  end

  test "a page's other headers stay", %{console: console, jar: jar} do
    {plain, packed} = {get(console, "/", jar), get(console, "/", jar, @gzip)}
    changing = ~w(content-length content-encoding date set-cookie)
    assert Map.drop(packed.headers, changing) == Map.drop(plain.headers, changing)
    assert packed.headers["cache-control"] == "no-store"
  end
end
