defmodule Aerie.Control.Policy.Audit.RefusalsTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Store
  alias Aerie.Control.Policy.{Audit, Roles}
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Aerie.Control.Policy.Audit.{Reader, Refusals}

  @minute 60_000_000
  @moduletag :tmp_dir

  setup do
    gateway = make_ref()
    start_supervised!({Store, gateway: gateway, tables: [ClientHistory.table()]})
    {:ok, gateway: gateway}
  end

  defp entry(n),
    do: %{"type" => "decision", "decision" => "deny", "source" => "eve", "command" => "mav_cmd_#{n}"}

  test "the first of a minute is written, the others are counted", %{gateway: gateway} do
    first = entry(0)
    assert Refusals.add(gateway, "eve", :role, first, 0) == [first]
    for n <- 1..500, do: assert(Refusals.add(gateway, "eve", :role, entry(n), n) == [])
    assert [_first] = Refusals.add(gateway, "eve", :rate, entry(1), 1)
    assert [_first] = Refusals.add(gateway, "mallory", :role, entry(1), 1)
    assert Refusals.due(gateway, @minute - 1) == []
    next = entry(501)

    assert [%{"type" => "refusals", "count" => 500, "source" => "eve"}, ^next] =
             Refusals.add(gateway, "eve", :role, next, @minute)

    assert Refusals.add(gateway, "eve", :role, next, @minute + 1) == []
    # Without a further one the log's process asks.
    assert [%{"count" => 1}] = Refusals.due(gateway, 2 * @minute)
    assert Refusals.due(gateway, 9 * @minute) == []
  end

  test "those who may nothing fill no log", %{gateway: gateway, tmp_dir: dir} do
    max = 262_144
    start_supervised!({Audit, gateway: gateway, dir: dir, max_bytes: max})
    {:ok, _n} = Audit.append(gateway, %{"type" => "decision", "command" => "arm", "decision" => "allow"})

    # As many names as there may be, each with refusals of its own: more than the log has room for.
    for n <- 1..3_000 do
      viewer = Roles.principal(:client, "viewer #{n}", :viewer)
      entry = Map.put(entry(n), "reason", String.duplicate("x", 300))
      :ok = Audit.refusal(gateway, viewer, :role, entry)
      # The log's process may not keep up with so many.
      if rem(n, 100) == 0, do: {:ok, _status} = Audit.status(gateway)
    end

    assert {:ok, %{missed: 0, bytes: bytes}} = Audit.status(gateway)
    assert bytes < div(max, 4)
    assert {:ok, %{records: [%{"decision" => "allow"}]}} = Reader.page(dir, %{text: "arm"})
  end

  test "who may nothing: viewers, strangers and nobody" do
    assert Refusals.nobody?(nil)
    assert Refusals.nobody?(Roles.principal(:key, "v", :viewer, [:terminate]))
    refute Refusals.nobody?(Roles.principal(:key, "o", :operator))
  end
end
