defmodule Aerie.Fleet.Bridge.Events.OutboxTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Events.Outbox
  alias Aerie.Fleet.Bridge.Events.Outbox.Record
  alias Aerie.PythonPeer

  @moduletag :tmp_dir

  defp record(n, size \\ 20) do
    %Record{
      id: "id-#{n}",
      vehicle: "V#{rem(n, 3)}",
      subject: "fleet.t.V.event.x",
      body: String.duplicate("b", size)
    }
  end

  defp open!(dir, opts \\ []) do
    {:ok, outbox} = Outbox.open(dir, Keyword.merge([max_bytes: 67_108_864, segment_bytes: 1_048_576], opts))
    outbox
  end

  defp append!(outbox, numbers, size \\ 20) do
    {:ok, outbox} = Outbox.append(outbox, Enum.map(numbers, &record(&1, size)))
    outbox
  end

  defp ids(records), do: Enum.map(records, fn {_seq, record} -> record.id end)

  test "what was appended is read in order, once", %{tmp_dir: dir} do
    outbox = dir |> open!() |> append!(1..5)
    {records, outbox} = Outbox.read(outbox, 3)
    assert [{1, %Record{id: "id-1", vehicle: "V1", body: "bbbb" <> _}}, {2, _}, {3, _}] = records
    {records, outbox} = Outbox.read(outbox, 10)
    assert ids(records) == ["id-4", "id-5"]
    assert {[], _} = Outbox.read(outbox, 10)
  end

  test "reopened without having been closed, it has what was not acknowledged", %{tmp_dir: dir} do
    outbox = dir |> open!(segment_bytes: 200) |> append!(1..10)
    {_, outbox} = Outbox.read(outbox, 10)
    outbox = Outbox.ack(outbox, [2, 1, 5])
    assert Outbox.stats(outbox).events == 7
    again = open!(dir, segment_bytes: 200)
    {records, again} = Outbox.read(again, 20)
    # 5 was acknowledged out of order, which only the running process knows.
    assert ids(records) == Enum.map(3..10, &"id-#{&1}")
    again = append!(again, [11])
    assert {[{11, _}], _} = Outbox.read(again, 20)
  end

  test "empty again, nothing but the head stays on disk and the numbers go on", %{tmp_dir: dir} do
    outbox = dir |> open!(segment_bytes: 100) |> append!(1..9)
    outbox = Outbox.ack(outbox, Enum.to_list(1..9))
    assert Outbox.empty?(outbox)
    assert Enum.sort(File.ls!(dir)) == ["FORMAT", "head"]
    outbox = append!(open!(dir), [10])
    assert {[{10, _}], _} = Outbox.read(outbox, 9)
  end

  test "full, the oldest segment goes and its events are counted", %{tmp_dir: dir} do
    outbox = dir |> open!(segment_bytes: 1_000, max_bytes: 4_000) |> append!(1..100, 150)
    stats = Outbox.stats(outbox)
    assert stats.bytes <= 4_000
    assert stats.dropped + stats.events == 100
    {records, _} = Outbox.read(outbox, 200)
    assert length(records) == stats.events
    assert List.last(ids(records)) == "id-100"
  end

  test "a record that NATS would never take is dropped, not kept for ever", %{tmp_dir: dir} do
    outbox = dir |> open!() |> append!([1], 200_000) |> append!([2])
    assert %{events: 1, dropped: 1} = Outbox.stats(outbox)
  end

  test "a torn tail costs the torn record only", %{tmp_dir: dir} do
    dir |> open!() |> append!(1..3)
    [file] = Path.wildcard(dir <> "/*.log")
    whole = File.read!(file)
    File.write!(file, binary_part(whole, 0, byte_size(whole) - 5))
    outbox = dir |> open!() |> append!([4])
    {records, _} = Outbox.read(outbox, 9)
    assert ids(records) == ["id-1", "id-2", "id-4"]
    assert Outbox.stats(outbox).damaged == 0
  end

  test "damage in the middle costs the rest of its segment; the others stay and nothing gets stuck", %{
    tmp_dir: dir
  } do
    dir |> open!(segment_bytes: 250) |> append!(1..10)
    [first | _] = dir |> Path.join("*.log") |> Path.wildcard() |> Enum.sort()
    <<start::binary-size(100), byte, rest::binary>> = File.read!(first)
    File.write!(first, <<start::binary, Bitwise.bxor(byte, 1), rest::binary>>)
    outbox = open!(dir, segment_bytes: 250)
    {records, outbox} = Outbox.read(outbox, 99)
    assert hd(ids(records)) == "id-1"
    assert List.last(ids(records)) == "id-10"
    assert length(records) in 6..9
    outbox = Outbox.ack(outbox, Enum.map(records, &elem(&1, 0)))
    assert Outbox.empty?(outbox)
    assert Path.wildcard(dir <> "/*.log") == []
  end

  test "an acknowledgement that comes after rewind/1 counts", %{tmp_dir: dir} do
    outbox = dir |> open!() |> append!(1..3)
    {_, outbox} = Outbox.read(outbox, 3)
    outbox = outbox |> Outbox.rewind() |> Outbox.ack([1, 2, 3])
    assert {[], outbox} = Outbox.read(outbox, 3)
    outbox = append!(outbox, [4])
    assert {[{4, _}], _} = Outbox.read(outbox, 3)
  end

  test "an unusable folder is an error", %{tmp_dir: dir} do
    File.write!(Path.join(dir, "file"), "")

    assert {:error, :enotdir} =
             Outbox.open(Path.join(dir, "file/outbox"), max_bytes: 4096, segment_bytes: 1024)
  end

  test "a disk that is full takes nothing and loses nothing" do
    # /dev/full says "no space left" to every write, as a full disk does.
    dir = Path.join(System.tmp_dir!(), "aerie-full-#{System.unique_integer([:positive])}")
    outbox = dir |> open!() |> append!([1])
    File.ln_s!("/dev/full", Path.join(dir, "0000000000000002.log"))
    full = %{outbox | segment_bytes: 1}
    assert {:error, :enospc, outbox, 0} = Outbox.append(full, [record(2)])
    assert %{events: 1} = Outbox.stats(outbox)
    # It cannot be cut to its old size either, and has nothing else in it: it is gone.
    refute File.exists?(Path.join(dir, "0000000000000002.log"))
    assert {:ok, outbox} = Outbox.append(outbox, [record(2)])
    assert {[{1, _}, {2, _}], _} = Outbox.read(outbox, 9)
    File.rm_rf!(dir)
  end

  test "full in the middle of a list: it says how many are written, and those are not written twice", %{
    tmp_dir: dir
  } do
    File.ln_s!("/dev/full", Path.join(dir, "0000000000000003.log"))
    # Without the full one among what is read at the start.
    outbox = dir |> Path.join("x") |> open!(segment_bytes: 100)
    outbox = put_in(outbox.store.dir, dir)
    large = record(9, 200_000)
    records = [record(1), large, record(2), record(3), large, record(4)]
    assert {:error, :enospc, outbox, 3} = Outbox.append(outbox, records)
    assert %{events: 2, dropped: 1} = Outbox.stats(outbox)
    assert {:ok, outbox} = Outbox.append(outbox, Enum.drop(records, 3))
    assert %{events: 4, dropped: 2} = Outbox.stats(outbox)
    assert {[{1, _}, {2, _}, {3, _}, {4, %{id: "id-4"}}], _} = Outbox.read(outbox, 9)
  end

  test "half a record that cannot be taken back ends its file; what follows goes into another", %{
    tmp_dir: dir
  } do
    dir |> open!() |> append!([1])
    outbox = open!(dir)
    [file] = Path.wildcard(dir <> "/*.log")
    whole = File.read!(file)
    File.rm!(file)
    # Neither written nor cut (no regular file is).
    File.ln_s!("/dev/full", file)
    assert {:error, :enospc, outbox, 0} = Outbox.append(outbox, [record(2)])
    assert %{events: 1, damaged: 1} = stats = Outbox.stats(outbox)
    File.rm!(file)
    File.write!(file, whole <> binary_part(whole, 0, 30))
    # The half record counts as room that is taken.
    assert stats.bytes > byte_size(whole)
    outbox = append!(outbox, [2])
    assert {[{1, _}, {2, %{id: "id-2"}}], _} = Outbox.read(outbox, 9)
    assert {[{1, _}, {2, %{id: "id-2"}}], outbox} = dir |> open!() |> Outbox.read(9)
    assert Outbox.empty?(Outbox.ack(outbox, [1, 2]))
    assert Path.wildcard(dir <> "/*.log") == []
  end

  @tag :python
  test "a torn tail that cannot be cut away takes nothing after it", %{tmp_dir: dir} do
    dir |> open!() |> append!(1..2)
    [file] = Path.wildcard(dir <> "/*.log")
    whole = File.read!(file)
    script = Path.expand("../../../../peers/sealed_file.py", __DIR__)
    peer = PythonPeer.start(script, [Base.encode16(binary_part(whole, 0, byte_size(whole) - 5))])
    sealed = PythonPeer.await(peer, "file ")
    File.rm!(file)
    File.ln_s!(sealed, file)
    outbox = dir |> open!() |> append!([3])
    assert length(Path.wildcard(dir <> "/*.log")) == 2
    assert {records, _} = Outbox.read(outbox, 9)
    assert ids(records) == ["id-1", "id-3"]
    assert {records, _} = dir |> open!() |> Outbox.read(9)
    assert ids(records) == ["id-1", "id-3"]
  end

  test "a file that is damaged from its first record on keeps its number, and hides nothing", %{tmp_dir: dir} do
    dir |> open!() |> append!([1])
    [file] = Path.wildcard(dir <> "/*.log")
    File.write!(file, :binary.copy(<<255>>, 100))
    outbox = dir |> open!() |> append!([2])
    assert {[{_, %{id: "id-2"}}], _} = Outbox.read(outbox, 9)
    assert {[{seq, %{id: "id-2"}}], outbox} = dir |> open!() |> Outbox.read(9)
    assert Outbox.empty?(Outbox.ack(outbox, [seq]))
    assert Path.wildcard(dir <> "/*.log") == []
  end

  # The model: the list of all records ever appended, and the set of acknowledged ones.
  test "any sequence of append, read, ack, rewind, crash and torn tail keeps its promises", %{tmp_dir: dir} do
    command =
      :proper_types.frequency([
        {5, {:append, :proper_types.integer(1, 6)}},
        {4, {:read, :proper_types.integer(1, 8)}},
        {3, {:ack, :proper_types.integer(0, 100)}},
        {1, :rewind},
        {1, :crash},
        {1, {:tear, :proper_types.integer(1, 40)}}
      ])

    property =
      :proper.forall(:proper_types.list(command), fn commands ->
        dir = Path.join(dir, Integer.to_string(System.unique_integer([:positive])))
        model = %{all: %{}, last: 0, acked: MapSet.new(), read: [], dir: dir}
        {outbox, model} = Enum.reduce(commands, {reopen(dir), model}, &run/2)
        {records, outbox} = outbox |> Outbox.rewind() |> Outbox.read(10_000)
        got = Enum.map(records, fn {seq, record} -> {seq, record.id} end)
        wanted = for {seq, id} <- Enum.sort(model.all), seq not in model.acked, do: {seq, id}
        done = Outbox.ack(outbox, Enum.map(records, &elem(&1, 0)))
        File.rm_rf!(dir)
        got == wanted and Outbox.empty?(done) and Outbox.stats(outbox).dropped == 0
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp reopen(dir), do: open!(dir, segment_bytes: 150, max_bytes: 1_000_000)

  defp run({:append, n}, {outbox, model}) do
    seqs = Enum.to_list((model.last + 1)..(model.last + n))
    all = Map.merge(model.all, Map.new(seqs, &{&1, "id-#{&1}"}))
    {append!(outbox, seqs), %{model | all: all, last: model.last + n}}
  end

  defp run({:read, n}, {outbox, model}) do
    {records, outbox} = Outbox.read(outbox, n)
    seqs = Enum.map(records, &elem(&1, 0))
    unless seqs == Enum.sort(seqs), do: raise("out of order")
    unless length(seqs) <= n, do: raise("too many")
    {outbox, %{model | read: model.read ++ seqs}}
  end

  # An acknowledgement of some record that was read.
  defp run({:ack, _}, {outbox, %{read: []} = model}), do: {outbox, model}

  defp run({:ack, n}, {outbox, model}) do
    {seq, read} = List.pop_at(model.read, rem(n, length(model.read)))
    {Outbox.ack(outbox, [seq]), %{model | read: read, acked: MapSet.put(model.acked, seq)}}
  end

  defp run(:rewind, {outbox, model}), do: {Outbox.rewind(outbox), %{model | read: []}}

  # The head is on disk; acknowledgements ahead of it are forgotten, so those records come again.
  defp run(:crash, {_outbox, model}), do: {reopen(model.dir), forget_ahead(%{model | read: []})}

  defp run({:tear, bytes}, {outbox, model}) do
    case model.dir |> Path.join("*.log") |> Path.wildcard() |> Enum.sort() |> List.last() do
      nil ->
        {outbox, model}

      file ->
        whole = File.read!(file)
        File.write!(file, binary_part(whole, 0, max(byte_size(whole) - bytes, 0)))
        outbox = reopen(model.dir)
        model = forget_ahead(%{model | read: []})
        # Whole records survive; what they are is read from the file's own header fields.
        left = for {seq, _} <- everything(outbox), into: MapSet.new(), do: seq
        last = Enum.max([outbox_next(outbox) - 1 | MapSet.to_list(left)])
        lost = for {seq, _} <- model.all, seq > last, do: seq
        if length(lost) > 2, do: raise("lost more than the torn records")
        {outbox, %{model | all: Map.drop(model.all, lost), last: last}}
    end
  end

  defp everything(outbox), do: outbox |> Outbox.rewind() |> Outbox.read(10_000) |> elem(0)
  defp outbox_next(outbox), do: outbox.next

  defp forget_ahead(model) do
    head = Enum.find(1..(model.last + 1), &(&1 not in model.acked))
    %{model | acked: MapSet.filter(model.acked, &(&1 < head))}
  end
end
