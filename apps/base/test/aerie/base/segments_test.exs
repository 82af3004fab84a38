defmodule Aerie.Base.SegmentsTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Segments
  alias Aerie.Base.Segments.Segment

  @moduletag :tmp_dir

  defp open(dir) do
    {:ok, store} = Segments.open(dir, ".log")
    {:ok, store} = Segments.load(store, &Segment.line/1)
    store
  end

  defp begin(store, first) do
    {:ok, store} = Segments.begin(store, first)
    store
  end

  defp append(store, texts) do
    {:ok, store} = Segments.append(store, Enum.map(texts, &(&1 <> "\n")), length(texts))
    store
  end

  defp lines(segment) do
    {:ok, _segment, _ending, lines} = Segment.fold(segment, &Segment.line/1, [], &[&1 | &2])
    Enum.reverse(lines)
  end

  defp names(dir), do: dir |> File.ls!() |> Enum.sort()

  test "files are named after their first records, and belong to their owner alone", %{tmp_dir: dir} do
    File.write!(Path.join(dir, "head"), "of its owner")
    File.write!(Path.join(dir, "0000000000000009.other"), "another's")
    store = dir |> open() |> begin(1) |> append(~w(a b)) |> begin(3) |> append(["c"])
    assert ["0000000000000001.log", "0000000000000003.log", "0000000000000009.other", "head"] = names(dir)
    for %{path: path} <- store.segments, do: assert(Bitwise.band(File.stat!(path).mode, 0o777) == 0o600)
    assert %{segments: [%{first: 1, count: 2, bytes: 4}, %{first: 3, count: 1, bytes: 2}]} = open(dir)
    assert {:ok, %{segments: [%{first: 1, bytes: 4}, %{first: 3, bytes: 2}]}} = Segments.open(dir, ".log")
    assert Segments.bytes(store) == 6
    assert %{first: 3} = Segments.find(store, 3)
    assert Segments.find(store, 4) == nil
    assert {:ok, store} = Segments.drop(store, hd(store.segments))
    assert %{segments: [%{first: 3}]} = store
    assert {:ok, %{segments: []}} = Segments.drop(store, Segments.last(store))
    assert names(dir) == ["0000000000000009.other", "head"]
  end

  test "a folder that cannot be read is an error", %{tmp_dir: dir} do
    assert Segments.open(Path.join(dir, "none"), ".log") == {:error, :enoent}
    File.mkdir!(Path.join(dir, "0000000000000001.log"))
    {:ok, store} = Segments.open(dir, ".log")
    assert {:error, :eisdir} = Segments.load(store, &Segment.line/1)
    assert {:error, :eisdir, ^store} = Segments.append(store, "a\n")
  end

  test "records are read from an offset, at most so many, up to one that cannot be read", %{tmp_dir: dir} do
    store = dir |> open() |> begin(1) |> append(~w(a bb c))
    segment = Segments.last(store)
    assert Segment.read(segment, &Segment.line/1, 0, 2) == {~w(a bb), 5}
    assert Segment.read(segment, &Segment.line/1, 5, 9) == {["c"], 2}
    File.write!(segment.path, "half", [:append])
    assert Segment.read(segment, &Segment.line/1, 5, 9) == {["c"], 2}
    assert Segment.read(segment, &Segment.line/1, 7, 9) == {[], 0}
    assert Segment.read(segment, &Segment.line/1, 0, 0) == {[], 0}
    File.rm!(segment.path)
    assert Segment.read(segment, &Segment.line/1, 0, 2) == {[], 0}
  end

  test "a full disk: what was written is undone; where that fails too, the waste is known", %{tmp_dir: dir} do
    # /dev/full says "no space left" to every write, as a full disk does, and cannot be cut.
    File.ln_s!("/dev/full", Path.join(dir, "0000000000000001.log"))
    {:ok, store} = %Segments{dir: dir, extension: ".log"} |> Segments.begin(1)
    assert {:error, :enospc, store} = Segments.append(store, "abc\n")
    assert %{count: 0, bytes: 0, waste: 4} = Segments.last(store)
    assert Segments.bytes(store) == 4
  end

  test "a file that ends its lines with two bytes loses nothing when it is written on", %{tmp_dir: dir} do
    File.write!(Path.join(dir, "0000000000000001.log"), "a\r\nb\r\n")
    store = dir |> open() |> append(["c"])
    assert store |> Segments.last() |> lines() == ~w(a b c)
  end

  # The model: the records that were written, in files; how many of them, and of the bytes after them, are safe.
  test "any sequence of append, begin, sync, drop, reopen and a crash at any byte keeps its promises", %{
    tmp_dir: dir
  } do
    command =
      :proper_types.frequency([
        {6, {:append, :proper_types.integer(1, 4)}},
        {2, :begin},
        {2, :sync},
        {1, :drop},
        {2, :reopen},
        {3, {:crash, :proper_types.integer(0, 60)}}
      ])

    property =
      :proper.forall(:proper_types.list(command), fn commands ->
        dir = Path.join(dir, Integer.to_string(System.unique_integer([:positive])))
        File.mkdir_p!(dir)
        model = %{dir: dir, files: [], next: 1, synced: 0}
        {store, model} = Enum.reduce(commands, {open(dir), model}, &run/2)
        same? = agree?(store, model) and agree?(open(dir), model)
        File.rm_rf!(dir)
        same?
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  defp agree?(store, model) do
    Enum.map(store.segments, &{&1.first, &1.count, &1.waste}) ==
      for({first, texts} <- model.files, do: {first, length(texts), 0}) and
      Enum.map(store.segments, &lines/1) == Enum.map(model.files, &elem(&1, 1)) and
      Segments.bytes(store) ==
        model.files |> Enum.flat_map(&elem(&1, 1)) |> Enum.map(&(byte_size(&1) + 1)) |> Enum.sum()
  end

  defp run({:append, n}, {%{segments: []} = store, model}), do: run({:append, n}, run(:begin, {store, model}))

  defp run({:append, n}, {store, model}) do
    texts =
      for number <- model.next..(model.next + n - 1),
          do: String.duplicate("record #{number} ", rem(number, 3) + 1)

    files = List.update_at(model.files, -1, fn {first, before} -> {first, before ++ texts} end)
    {append(store, texts), %{model | files: files, next: model.next + n}}
  end

  # Not two with one number.
  defp run(:begin, {store, model}) do
    case List.last(model.files) do
      {_first, []} -> {store, model}
      _other -> {begin(store, model.next), %{model | files: model.files ++ [{model.next, []}], synced: 0}}
    end
  end

  defp run(:sync, {store, model}) do
    :ok = Segments.sync(store)

    {store,
     %{model | synced: with({_first, texts} <- List.last(model.files), do: length(texts), else: (nil -> 0))}}
  end

  defp run(:drop, {%{segments: []} = store, model}), do: {store, model}

  defp run(:drop, {store, model}) do
    {:ok, store} = Segments.drop(store, hd(store.segments))
    [_dropped | files] = model.files
    {store, %{model | files: files, synced: if(files == [], do: 0, else: model.synced)}}
  end

  defp run(:reopen, {store, model}) do
    _closed = Segments.close(store)
    {open(model.dir), model}
  end

  # The end of the last file is lost, up to what was synced; then whole records count, and half of one goes.
  defp run({:crash, _lost}, {store, %{files: []} = model}), do: run(:reopen, {store, model})

  defp run({:crash, lost}, {_store, model}) do
    {first, texts} = List.last(model.files)
    {safe, unsafe} = Enum.split(texts, model.synced)
    path = Path.join(model.dir, String.pad_leading("#{first}", 16, "0") <> ".log")
    whole = File.read!(path)
    safe_bytes = Enum.sum(Enum.map(safe, &(byte_size(&1) + 1)))
    size = max(byte_size(whole) - lost, safe_bytes)
    File.write!(path, binary_part(whole, 0, size))
    kept = safe ++ fitting(unsafe, size - safe_bytes)
    files = List.replace_at(model.files, -1, {first, kept})
    {open(model.dir), %{model | files: files, next: first + length(kept), synced: length(kept)}}
  end

  defp fitting([text | texts], left) when byte_size(text) < left,
    do: [text | fitting(texts, left - byte_size(text) - 1)]

  defp fitting(_texts, _left), do: []
end
