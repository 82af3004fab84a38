defmodule Aerie.Console.AssetsTest do
  use Aerie.ConsoleCase, async: true

  import Aerie.HTTPClient

  alias Aerie.Console.Assets

  setup do: {:ok, start_console()}

  test "scripts and styles are there under an address that is good for ever", %{console: console} do
    for name <- ["console.js", "css/tokens.css", "hooks/dialog.js", "icon.svg"] do
      answer = get(console, Assets.path(console.gateway, name))
      assert answer.status == 200
      assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"
      assert answer.headers["x-content-type-options"] == "nosniff"
    end

    assert get(console, Assets.path(console.gateway, "console.js")).headers["content-type"] =~
             "text/javascript"
  end

  test "every style sheet is in the page, tokens first", %{console: console} do
    assert ["css/tokens.css", "css/base.css", "css/ui.css" | _pages] = styles = Assets.styles(console.gateway)
    page = get(console, "/sign-in").body
    for style <- styles, do: assert(page =~ Assets.path(console.gateway, style))
  end

  test "an address of before an update gets the present asset, to be asked for again", %{console: console} do
    answer = get(console, "/assets/older/console.js")
    assert answer.status == 200
    assert answer.headers["cache-control"] == "no-cache"
    again = get(console, "/assets/older/console.js", %{}, [{"if-none-match", answer.headers["etag"]}])
    assert again.status == 304 and again.body == ""
  end

  test "serves gzip to clients that take it", %{console: console} do
    path = Assets.path(console.gateway, "css/ui.css")
    plain = get(console, path)
    packed = get(console, path, %{}, [{"accept-encoding", "br, gzip"}])
    assert packed.headers["content-encoding"] == "gzip"
    assert :zlib.gunzip(packed.body) == plain.body
    refused = get(console, path, %{}, [{"accept-encoding", "gzip;q=0, br"}])
    refute Map.has_key?(refused.headers, "content-encoding")
  end

  test "nothing else is there, whatever the path", %{console: console} do
    for path <- [
          "/assets/x/../../mix.exs",
          "/assets/x/..%2f..%2fmix.exs",
          "/assets/x/%2e%2e/%2e%2e/mix.exs",
          "/assets/x//etc/passwd",
          "/assets/x/hooks",
          "/assets/x/npm/phoenix/package.json",
          "/assets/x/"
        ] do
      answer = get(console, path)
      assert answer.status in [302, 400, 404]
      refute answer.body =~ "defmodule"
    end
  end

  @tag :node
  test "the packages of npm are there, under their own names", %{console: console} do
    assert Assets.missing(console.gateway) == []

    for name <- [
          "phoenix/phoenix.mjs",
          "phoenix_live_view/phoenix_live_view.esm.js",
          "maplibre-gl/maplibre-gl.mjs"
        ],
        do: assert(get(console, Assets.path(console.gateway, "npm/" <> name)).status == 200)

    font = get(console, Assets.path(console.gateway, Assets.font()))
    assert font.headers["content-type"] == "font/woff2"

    assert get(console, "/sign-in").body =~
             ~s(rel="preload" href="#{Assets.path(console.gateway, Assets.font())}")
  end

  @tag :node
  test "a large one is what its file was at start, for every client, and kept compressed", %{console: console} do
    name = "npm/world-atlas/countries-10m.json"
    {:ok, content} = Assets.read(name)
    path = Assets.path(console.gateway, name)

    answers =
      for _client <- 1..3, do: Task.async(fn -> get(console, path, %{}, [{"accept-encoding", "gzip"}]) end)

    for %{body: body} <- Task.await_many(answers, 60_000), do: assert(:zlib.gunzip(body) == content)
    assert get(console, path).body == content
    assert %{plain: nil, gzip: gzip} = Assets.find(console.gateway, name)
    assert byte_size(gzip) < byte_size(content) / 3
  end
end
