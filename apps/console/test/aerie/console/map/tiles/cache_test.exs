defmodule Aerie.Console.Map.Tiles.CacheTest do
  use ExUnit.Case, async: true

  alias Aerie.Console.Map.Tiles.{Cache, Layer}

  @moduletag :tmp_dir
  @entry %{type: "image/png", gzip?: false, etag: "e", until: 5, body: "a\nb"}

  test "what was kept is there again, also the absence of a tile", %{tmp_dir: dir} do
    path = Cache.path(dir, Layer.openstreetmap(nil), {3, 4, 5})
    assert Cache.read(path, 0) == nil

    for entry <- [@entry, %{@entry | type: nil, etag: nil, body: ""}] do
      assert Cache.write(path, entry) == :ok
      assert Cache.read(path, 0) == entry
    end
  end

  test "another address under the same id has other files" do
    one = Layer.openstreetmap("https://a/{z}/{x}/{y}")

    assert Cache.path("d", one, {0, 0, 0}) !=
             Cache.path("d", Layer.openstreetmap("https://b/{z}/{x}/{y}"), {0, 0, 0})
  end

  test "a file that was cut off or is something else is ignored", %{tmp_dir: dir} do
    path = Path.join(dir, "t")
    Cache.write(path, @entry)
    whole = File.read!(path)

    for bytes <- ["", "x", "{}\n", "[1]\nx", "\n", binary_part(whole, 0, byte_size(whole) - 1), whole <> "x"] do
      File.write!(path, bytes)
      assert Cache.read(path, 0) == nil
    end
  end

  test "of too many bytes, those go that nobody has looked at for longest", %{tmp_dir: dir} do
    day = 86_400
    layer = Layer.openstreetmap(nil)
    paths = for x <- 0..9, do: Cache.path(dir, layer, {4, x, 0})

    for {path, n} <- Enum.with_index(paths) do
      Cache.write(path, %{@entry | body: String.duplicate("x", 10_000)})
      File.touch!(path, 100 * day + n)
    end

    # The oldest is looked at again.
    assert Cache.read(hd(paths), 102 * day)
    folder = Cache.folder(layer)
    assert %{^folder => {10, bytes}} = Cache.sweep(dir, 200_000)
    assert bytes in 100_000..102_000
    assert %{^folder => {tiles, bytes}} = Cache.sweep(dir, 50_000)
    assert bytes in 30_000..50_000 and tiles in 3..4
    assert File.exists?(hd(paths)) and File.exists?(List.last(paths))
    refute File.exists?(Enum.at(paths, 1))
    refute File.exists?(Path.dirname(Enum.at(paths, 1)))
    assert Cache.sweep(dir, 0) == %{}
    assert Cache.sweep(Path.join(dir, "nowhere"), 1) == %{}
  end
end
