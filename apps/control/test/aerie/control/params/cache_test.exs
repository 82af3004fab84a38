defmodule Aerie.Control.Params.CacheTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Params.{Cache, Param, Table}

  @moduletag :tmp_dir
  @key {:system, "net", 1}
  @table Table.new([%Param{name: "A", value: 5, type: 4, default: 3}, %Param{name: "B", value: 0.5, type: 9}],
           hash: 77
         )

  defp file(dir), do: dir |> File.ls!() |> hd() |> then(&Path.join(dir, &1))

  test "a list is read back as it was stored, by its vehicle alone", %{tmp_dir: dir} do
    dir = Path.join(dir, "params")
    assert Cache.load(dir, @key) == :none
    assert Cache.store(dir, @key, @table, 10) == :ok
    assert Cache.load(dir, @key) == {:ok, @table}
    assert Cache.load(dir, {:uid, "1"}) == :none
    assert Bitwise.band(File.stat!(file(dir)).mode, 0o777) == 0o600
  end

  test "beyond a number of files the oldest goes", %{tmp_dir: dir} do
    keys = for n <- 1..4, do: {:system, "net", n}

    for {key, n} <- Enum.with_index(keys) do
      before = File.ls!(dir)
      :ok = Cache.store(dir, key, @table, 3)
      for new <- File.ls!(dir) -- before, do: File.touch!(Path.join(dir, new), 1_000 + n)
    end

    assert for(key <- keys, do: Cache.load(dir, key) != :none) == [false, true, true, true]
  end

  test "ignores a damaged file, and one of another version", %{tmp_dir: dir} do
    :ok = Cache.store(dir, @key, @table, 10)
    text = File.read!(file(dir))

    for broken <- [
          String.replace(text, "aerie-params 2", "aerie-params 1"),
          binary_part(text, 0, 40),
          String.replace(text, "0.5", "0.6"),
          ""
        ] do
      File.write!(file(dir), broken)
      assert Cache.load(dir, @key) == :none
    end
  end

  test "only the vehicle's own word makes a stored list fresh (P6)" do
    assert Cache.freshness(@table, %{hash: 77}) == :fresh
    assert Cache.freshness(@table, %{hash: 78}) == :stale
    assert Cache.freshness(@table, %{count: 2}) == :unknown
    assert Cache.freshness(@table, %{count: 3}) == :stale
    assert Cache.freshness(@table, %{hash: 77, count: 3}) == :stale
    assert Cache.freshness(@table, %{}) == :unknown
    assert Cache.freshness(%{@table | hash: nil}, %{hash: nil}) == :unknown
    assert Cache.freshness(%{@table | hash: nil, file_crc: 5}, %{file_crc: 5}) == :fresh
    assert Cache.freshness(%{@table | file_crc: 5}, %{hash: 77, file_crc: 6}) == :stale
  end
end
