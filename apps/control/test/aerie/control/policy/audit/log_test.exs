defmodule Aerie.Control.Policy.Audit.LogTest do
  use ExUnit.Case, async: true

  import Aerie.OtherVM

  alias Aerie.Control.Policy.Audit.{Chain, Log, Record, Verify}
  alias Aerie.Base.Segments

  @moduletag :tmp_dir
  @now 1_795_339_800_000_000
  @max 1_048_576

  defp open(dir, max \\ @max) do
    {:ok, log} = Log.open(dir, max, @now)
    log
  end

  defp append(log, entry) do
    {:ok, log} = Log.append(log, entry, @now)
    log
  end

  defp fill(dir, n, max \\ @max) do
    log = Enum.reduce(1..n, open(dir, max), &append(&2, %{"type" => "decision", "id" => "c#{&1}"}))
    :ok = Log.close(log)
    log
  end

  defp report(dir, known \\ nil) do
    {:ok, report} = Verify.folder(dir, known)
    report
  end

  defp files(dir) do
    {:ok, %{segments: segments}} = Chain.files(dir)
    Enum.map(segments, & &1.path)
  end

  defp change(path, fun), do: File.write!(path, path |> File.read!() |> fun.())
  defp lines(dir), do: Enum.flat_map(files(dir), &(&1 |> File.read!() |> String.split("\n", trim: true)))

  test "records are lines of JSON, each with the hash of the one before; several lives make one chain", %{
    tmp_dir: dir
  } do
    fill(dir, 3)
    log = fill(dir, 2)
    assert %{records: 7, first: 1, last: 7, problems: [], notes: []} = report = report(dir)
    assert Log.head(log) == {7, report.hash}
    assert report(dir, {7, report.hash}).problems == []
    records = Enum.map(lines(dir), &JSON.decode!/1)
    assert Enum.map(records, & &1["type"]) == ~w(opened decision decision decision opened decision decision)
    assert hd(records)["prev"] == Record.start() and hd(records)["format"] == 1
    for [a, b] <- Enum.chunk_every(records, 2, 1, :discard), do: assert(b["prev"] == a["hash"])
    assert hd(records)["at"] == "2026-11-22T09:30:00.000000Z"
    # For nobody else.
    assert Bitwise.band(File.stat!(dir).mode, 0o777) == 0o700
    for file <- files(dir), do: assert(Bitwise.band(File.stat!(file).mode, 0o777) == 0o600)
  end

  test "the hashes can be checked without this program", %{tmp_dir: dir} do
    fill(dir, 5)

    script = """
    import hashlib, json, sys
    last = None
    for line in open(sys.argv[1], "rb"):
        body, _, _ = line.rpartition(b',"hash":"')
        record = json.loads(line)
        assert record["hash"] == hashlib.sha256(body).hexdigest()
        assert last in (None, record["prev"])
        last = record["hash"]
    print(last)
    """

    if python = System.find_executable("python3") do
      assert {hash, 0} = System.cmd(python, ["-c", script, hd(files(dir))])
      assert String.trim(hash) == report(dir).hash
    end
  end

  test "what is not text, or too long, spoils nothing", %{tmp_dir: dir} do
    log =
      open(dir)
      |> append(%{
        "type" => "decision",
        "source" => <<255, 0>>,
        "n" => 99,
        "hash" => "x",
        "rule" => :geofence
      })
      |> append(%{"type" => "decision", "id" => "long", "params" => %{"a" => String.duplicate("x", 100_000)}})

    Log.close(log)
    assert [_opened, odd, long] = Enum.map(lines(dir), &JSON.decode!/1)
    assert %{"source" => "ff00", "n" => 2, "rule" => "geofence"} = odd
    assert %{"id" => "long", "cut" => true} = long
    refute is_map_key(long, "params")
    assert report(dir).problems == []
  end

  test "any change of any byte is found", %{tmp_dir: dir} do
    fill(dir, 20)
    [file] = files(dir)
    whole = File.read!(file)
    {_n, last} = Log.safe(dir)

    property =
      :proper.forall({:proper_types.integer(0, byte_size(whole) - 1), :proper_types.integer(1, 255)}, fn {at,
                                                                                                          by} ->
        <<before::binary-size(^at), byte, rest::binary>> = whole
        File.write!(file, <<before::binary, Bitwise.bxor(byte, by), rest::binary>>)
        report(dir).problems != []
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())

    # Lines that are swapped, removed or repeated, and an end that is cut off at a line.
    lines = String.split(whole, "\n", trim: true)

    for changed <- [
          List.delete_at(lines, 5),
          List.insert_at(lines, 5, Enum.at(lines, 5)),
          [Enum.at(lines, 1), Enum.at(lines, 0) | Enum.drop(lines, 2)],
          Enum.drop(lines, 1),
          Enum.drop(lines, -1)
        ] do
      File.write!(file, Enum.map(changed, &(&1 <> "\n")))
      assert report(dir).problems != []
    end

    # Somebody who rewrites the head too is found by comparing with a copy.
    {:ok, %{n: n, hash: hash}} = lines |> Enum.at(-2) |> Record.decode()
    File.write!(Path.join(dir, "head"), "#{n} #{hash}\n")
    assert report(dir).problems == []
    assert report(dir, {21, last}).problems == ["record 21: is missing, though it had been written"]
  end

  test "a torn last line is set aside in a record, wherever it was torn", %{tmp_dir: dir} do
    fill(dir, 3)
    [file] = files(dir)
    whole = File.read!(file)
    File.rm!(Path.join(dir, "head"))
    last = whole |> String.split("\n", trim: true) |> List.last()
    start = byte_size(whole) - byte_size(last) - 1

    for cut <- [1, 40, byte_size(last)] do
      File.write!(file, binary_part(whole, 0, start + cut))
      assert [problem] = report(dir).problems
      assert problem =~ "ends within a line (#{cut} bytes)"
      Log.close(open(dir))
      assert %{problems: [], notes: [note]} = report(dir)
      assert note == "record 4: a line of #{cut} bytes was torn and set aside"
      assert %{"type" => "repaired", "torn" => torn} = dir |> lines() |> Enum.at(3) |> JSON.decode!()
      assert Base.decode64!(torn) == binary_part(last, 0, cut)
      File.rm!(Path.join(dir, "head"))
    end
  end

  test "what was tampered with is not repaired: it stays, the log says so, and a new file goes on behind it",
       %{
         tmp_dir: dir
       } do
    fill(dir, 5)
    [file] = files(dir)
    change(file, &String.replace(&1, "c3", "c9"))
    damaged = File.read!(file)
    fill(dir, 2)
    assert File.read!(file) == damaged
    assert [^file, _next] = files(dir)
    assert [told, later] = report(dir).problems
    assert told =~ "line 4: was changed"
    assert later =~ "had been damaged from line 4 on"
  end

  test "a log that was shortened says so for ever", %{tmp_dir: dir} do
    fill(dir, 5)
    [file] = files(dir)

    change(file, fn text ->
      text |> String.split("\n", trim: true) |> Enum.drop(-2) |> Enum.map_join(&(&1 <> "\n"))
    end)

    fill(dir, 5)
    assert Enum.any?(report(dir).problems, &(&1 =~ "the log had been shortened; it had reached record 6"))
    File.rm!(file)
    assert report(dir).problems != []
    fill(dir, 1)
    assert report(dir).problems != []
  end

  test "old files make room, and the log explains where it begins", %{tmp_dir: dir} do
    max = 8 * 16_384
    fill(dir, 2000, max)
    size = dir |> files() |> Enum.map(&File.stat!(&1).size) |> Enum.sum()
    assert size <= max
    assert %{first: first, problems: []} = report = report(dir)
    assert first > 1
    assert report.records == report.last - first + 1
    # Somebody else's pruning is another matter.
    File.rm!(hd(files(dir)))
    assert [problem] = report(dir).problems
    assert problem =~ "no record says that those before it were removed"
  end

  test "a full disk: the write is taken back, and the log goes on as if nothing had been", %{tmp_dir: dir} do
    log = open(dir)
    # /dev/full says "no space left" to every write, as a full disk does.
    {:ok, full} = :file.open(~c"/dev/full", [:read, :write, :raw, :binary])
    segment = Segments.last(log.store)

    on = fn log, file ->
      %{log | store: Segments.put_last(log.store, %{Segments.last(log.store) | file: file})}
    end

    assert {:error, text, failed} = Log.append(on.(log, full), %{"type" => "decision"}, @now)
    assert text == "#{dir}: no space left on device"
    log = append(on.(failed, segment.file), %{"type" => "decision"})
    Log.close(log)
    assert %{records: 2, problems: []} = report(dir)
  end

  test "kill -9 while it is written: no record that was answered is lost, and the chain holds", %{
    tmp_dir: dir
  } do
    script = """
    alias Aerie.Control.Policy.Audit.Log
    {:ok, log} = Log.open(#{inspect(dir)}, 400_000, System.os_time(:microsecond))
    Enum.reduce(Stream.iterate(1, &(&1 + 1)), log, fn n, log ->
      {:ok, log} = Log.append(log, %{"type" => "decision", "id" => "c\#{n}"}, System.os_time(:microsecond))
      if rem(n, 100) == 0, do: :ok = Log.sync(log)
      if n == 500, do: IO.puts("busy \#{System.pid()}")
      if rem(n, 50) == 0, do: IO.puts("n \#{elem(Log.head(log), 0)}")
      log
    end)
    """

    {port, pid} = other_vm(script, "busy ")
    kill9(pid)
    told = said(port, 500)
    assert report(dir).problems == [] or match?([_torn], report(dir).problems)
    fill(dir, 1)
    assert %{problems: [], last: last} = report(dir)
    assert last >= told
  end

  defp said(port, last) do
    receive do
      {^port, {:data, {:eol, "n " <> n}}} -> said(port, String.to_integer(n))
    after
      0 -> last
    end
  end
end
