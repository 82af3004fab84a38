defmodule Aerie.Fleet.InspectorTest do
  use ExUnit.Case, async: true
  use Aerie.RecorderCase

  alias Aerie.Base.Store
  alias Aerie.Fleet.Inspector
  alias MavRouter.Recorder
  alias Aerie.Fleet.Inspector.{Fields, Rows}
  alias MavRouter.Recorder.{Tables, Tap}

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    gateway = start_recorder(dir)
    start_supervised!({Inspector, gateway: gateway, every_ms: 20})
    Store.put_link(gateway, "radio", %{id: "radio", network: "main"})
    {:ok, gateway: gateway}
  end

  defp heard(gateway, frames, link \\ "radio"), do: Recorder.link_frames(gateway, link, frames)

  defp row(gateway, id),
    do: eventually(fn -> Enum.find(Inspector.rows(gateway), &(elem(&1.key, 4) == id)) end)

  defp tapped?(gateway), do: gateway |> Tables.of() |> Tap.open?({:link, "radio"})

  test "nobody looks: links have no tap; with the last watcher it is gone again", c do
    heard(c.gateway, attitudes(1, 1..3))
    refute tapped?(c.gateway)
    watcher = Task.async(fn -> {Inspector.watch(c.gateway), receive(do: (:end -> :ok))} end)
    eventually(fn -> tapped?(c.gateway) end)
    assert Inspector.watch(c.gateway) == :ok
    send(watcher.pid, :end)
    assert Task.await(watcher, Aerie.Patience.ms()) == {:ok, :ok}
    heard(c.gateway, attitudes(1, 1..3))
    assert row(c.gateway, 30)
    assert Inspector.unwatch(c.gateway) == :ok
    refute tapped?(c.gateway)
    assert Inspector.rows(c.gateway) == []
  end

  test "each message of a component by a link has a row with count, rate and its last frame", c do
    assert Inspector.watch(c.gateway) == :ok
    heard(c.gateway, attitudes(1, 1..4))
    heard(c.gateway, attitudes(2, 1..1))
    eventually(fn -> match?(%{count: 4}, row(c.gateway, 30)) end)
    eventually(fn -> row(c.gateway, 30).hz > 0 end)
    assert [%{key: {"radio", :in, 2, 1, 30} = key}] = Inspector.rows(c.gateway, system: 2)
    assert [] = Inspector.rows(c.gateway, direction: :out)
    assert %{system: 2, crc_extra: 39} = frame = Inspector.last(c.gateway, key)
    assert %{value: "1"} = Enum.find(Fields.of(frame), &(&1.name == "time_boot_ms"))
    # What the link sends has rows of its own.
    bytes = MavCodec.encode(%MavCodec.Messages.Ping{seq: 7}, system: 237, component: 191)
    Recorder.sent(c.gateway, "radio", "main", bytes)
    assert %{key: {"radio", :out, 237, 191, 4}} = row(c.gateway, 4)
    assert Inspector.last(c.gateway, {"radio", :in, 9, 9, 9}) == nil
  end

  test "a link that comes later is seen, and one that is gone is let go", c do
    assert Inspector.watch(c.gateway) == :ok
    Store.put_link(c.gateway, "later", %{id: "later", network: "main"})
    tables = Tables.of(c.gateway)
    eventually(fn -> Tap.open?(tables, {:link, "later"}) end)
    Store.delete_link(c.gateway, "later")
    eventually(fn -> not Tap.open?(tables, {:link, "later"}) end)
  end

  test "S9: the key in SETUP_SIGNING is not shown", c do
    assert Inspector.watch(c.gateway) == :ok
    key = :binary.copy(<<7>>, 32)
    bytes = MavCodec.encode(%MavCodec.Messages.SetupSigning{secret_key: key}, system: 1, component: 1)
    heard(c.gateway, [frame(bytes, 1)])
    shown = Inspector.last(c.gateway, row(c.gateway, 256).key)
    assert :binary.match(shown.bytes, key) == :nomatch
  end

  test "what it cannot take at once is left out and counted, and the link never waits", c do
    assert Inspector.watch(c.gateway) == :ok
    inspector = Aerie.Base.Names.whereis(c.gateway, :inspector)
    :sys.suspend(inspector, Aerie.Patience.ms())
    for n <- 1..40, do: heard(c.gateway, attitudes(1, (n * 100)..(n * 100 + 99)))
    {:message_queue_len, waiting} = Process.info(inspector, :message_queue_len)
    assert waiting < 40
    :sys.resume(inspector, Aerie.Patience.ms())

    skipped =
      eventually(fn ->
        n = Inspector.skipped(c.gateway)
        n > 0 && n
      end)

    assert %{count: count} =
             eventually(fn ->
               r = row(c.gateway, 30)
               r.count + skipped == 4000 && r
             end)

    assert count > 0
  end

  test "a recorder that is ending takes its tables along, and not the inspector", c do
    assert Inspector.watch(c.gateway) == :ok
    pid = Aerie.Base.Names.whereis(c.gateway, :inspector)
    :ets.delete(Tables.of(c.gateway).taps)
    send(pid, :measure)
    assert %{taps: taps} = :sys.get_state(pid)
    assert taps == %{}
    assert Inspector.unwatch(c.gateway) == :ok
  end

  test "the rows are bounded; silent ones are forgotten" do
    rows = Rows.new()
    for system <- 1..9_000, do: Rows.add(rows, "radio", :in, [beat(1, false, 5) |> Map.put(:system, system)])
    assert length(Rows.list(rows, [])) < 8_192
    Rows.measure(rows, 0, System.monotonic_time(:millisecond))
    assert Rows.skipped(rows) > 800
    Rows.measure(rows, 0, System.monotonic_time(:millisecond) + 61_000)
    assert Rows.list(rows, []) == []
  end

  test "without a gateway or a recorder it says so" do
    assert Inspector.watch(make_ref()) == {:error, :not_running}
    gateway = start_parts()
    start_supervised!({Inspector, gateway: gateway}, id: :bare)
    assert Inspector.watch(gateway) == {:error, :no_recorder}
    assert Inspector.rows(make_ref()) == []
    assert Inspector.skipped(make_ref()) == 0
  end
end
