defmodule Aerie.Fleet.Shadow.LoopTest do
  @moduledoc """
  The loop of a vehicle behind the real pipeline, with policy, ledger and audit log; the test is the vehicle's executor.
  """
  use Aerie.ShadowCase, async: true

  @moduletag :tmp_dir
  @moduletag :capture_log

  @vehicle "VID-007"

  setup %{tmp_dir: dir} = context do
    gateway = start_commands(dir, policy: context[:policy] || [])
    flying(gateway)
    start_shadow(gateway, dir, [{"shadow.hold_s", 1} | context[:shadow] || []])
    loop = start_loop(gateway)
    %{gateway: gateway, loop: loop}
  end

  defp flying(gateway, changes \\ %{}), do: put_vehicle(gateway, Map.merge(%{in_air: true}, changes))

  defp desire(gateway, desired, more \\ %{}),
    do: {:ok, _done} = Shadow.update(gateway, @vehicle, Map.put(more, "desired", desired))

  test "a mode: commanded in the shadow's name, pending until the vehicle shows it, then converged",
       context do
    %{gateway: gateway, tmp_dir: dir} = context
    desire(gateway, %{"mode" => "LOITER"}, %{"reason" => "storm"})
    from = executing(%{type: "set_mode", source: "shadow", params: %{mode: "LOITER"}, id: id})
    assert %{why: "being set"} = standing(gateway, "mode", :pending)
    # In this order: two seconds after an acceptance that it does not see it tries again.
    flying(gateway, %{mode: "LOITER"})
    answer(from, id, :accepted)
    standing(gateway, "mode", :converged)
    assert {:ok, %{"delta" => delta}} = Shadow.delta(gateway, @vehicle)
    assert delta == %{}
    assert "shadow" in for(%{"via" => via} <- audit(dir), do: via)

    assert {:ok, %{"reported" => reported, "set" => %{"mode" => %{"reason" => "storm", "actor" => "elixir"}}}} =
             Shadow.get(gateway, @vehicle)

    assert %{
             "mode" => "LOITER",
             "armed" => true,
             "in_air" => true,
             "status" => "online",
             "desired_version" => 1
           } = reported

    # An attempt has three seconds; on a busy machine another may follow, but not one with each look.
    assert Store.counter(gateway, {:shadow, :commands_issued}) in 1..5
    assert Store.counter(gateway, {:shadow, :reconciliations}) > 1
  end

  # Long enough for a busy machine to see that nothing is sent in that time.
  @tag shadow: [{"shadow.hold_s", 5}]
  test "a pilot who takes over while it is being set is not fought; afterwards it goes on", %{
    gateway: gateway
  } do
    # In flight the shadow may not move a home.
    put_vehicle(gateway)
    rc = fn roll -> %{rc: %{at: 0, data: %{channels: [roll, 1500, 1500, 1500, 1000]}}} end
    groups(gateway, rc.(1500))
    desire(gateway, %{"mode" => "LOITER", "home" => %{"lat" => 47.0, "lon" => 8.1, "altitude_msl" => 500}})
    from = executing(%{type: "set_home", id: id})
    groups(gateway, rc.(1700))
    answer(from, id, :accepted)
    groups(gateway, Map.put(rc.(1700), :home, %{at: 0, data: %{lat: 47.0, lon: 8.1, alt_msl: 500.0}}))

    # On a busy machine hold_s may be over before both are seen, so he goes on moving it.
    until =
      eventually(fn ->
        groups(gateway, rc.(Enum.random([1600, 1650, 1700, 1750])))

        with %{"mode" => %{state: :held, by: "rc", until: until}} <- Shadow.report(gateway, @vehicle),
             {:ok, %{"reported" => %{"holds" => [%{"by" => "rc"} | _more]}}} <- Shadow.get(gateway, @vehicle),
             do: until,
             else: (_other -> false)
      end)

    # Nobody moves a stick for hold_s, and nothing is sent before.
    from = executing(%{type: "set_mode", id: id})
    assert System.os_time(:microsecond) >= until
    answer(from, id, :accepted)
  end

  # Both are to be seen at once, on a busy machine as well.
  @tag shadow: [{"shadow.hold_s", 60}]
  test "an operator's direct command holds it, and a failsafe does", %{gateway: gateway} do
    task = command(gateway, "set_speed", id: "s", params: %{speed: 3})
    answer(executing(%{id: "s"}), "s", :accepted)
    assert {:ok, _result} = Task.await(task, Aerie.Patience.ms())
    flying(gateway, %{failsafe: true})
    desire(gateway, %{"mode" => "LOITER"})
    assert %{by: by} = standing(gateway, "mode", :held)
    assert by in ["begun", "failsafe", "operator"]
    assert {:ok, %{"reported" => %{"holds" => holds}}} = Shadow.get(gateway, @vehicle)
    assert ["failsafe", "operator"] -- Enum.map(holds, & &1["by"]) == []
  end

  test "a clock that is set an hour forth ends no hold", %{gateway: gateway, loop: loop} do
    flying(gateway, %{failsafe: true})
    desire(gateway, %{"mode" => "LOITER"})
    %{until: until} = held(gateway, "mode", "failsafe")
    hour = 3_600_000_000
    # As if the clock had been an hour behind until now.
    :sys.replace_state(loop, &%{&1 | clock: &1.clock - hour})
    # The offset of two clocks is read again, and is a little different each time.
    eventually(fn -> held(gateway, "mode", "failsafe").until >= until + hour - 500_000 end)
  end

  @tag policy: [modes: %{denied: ["ACRO"], transitions: %{}}]
  test "the policy denies, as to everybody; the report says so, and it is tried again later", %{
    gateway: gateway
  } do
    desire(gateway, %{"mode" => "ACRO"})

    # Two seconds later the next attempt begins, so all is seen at once.
    eventually(fn ->
      with %{"mode" => %{state: :pending, why: "tried again later" <> _ = why, until: _until}} <-
             Shadow.report(gateway, @vehicle),
           do: why =~ "ACRO",
           else: (_other -> false)
    end)

    assert {:ok, %{"delta" => %{"mode" => "ACRO"}, "fields" => %{"mode" => %{"state" => "pending"}}}} =
             Shadow.delta(gateway, @vehicle)
  end

  test "armed is refused, and nothing of it reaches the vehicle", %{gateway: gateway} do
    desire(gateway, %{"armed" => false, "tags" => ["survey"]})
    assert %{why: "shadow.allow_arming is false" <> _} = standing(gateway, "armed", :refused)
    standing(gateway, "tags", :converged)
    assert {:ok, %{"reported" => %{"tags" => ["survey"]}}} = Shadow.get(gateway, @vehicle)
    refute_submitted()
  end

  @tag shadow: [{"shadow.allow_arming", true}]
  test "with shadow.allow_arming it is disarmed on the ground, and not in the air", %{gateway: gateway} do
    desire(gateway, %{"armed" => false})
    held(gateway, "armed", "air")
    flying(gateway, %{in_air: false})
    from = executing(%{type: "disarm", source: "shadow", id: id})
    answer(from, id, :completed)
  end

  @tag shadow: [{"shadow.enabled", false}]
  test "switched off, it only shows differences", %{gateway: gateway} do
    desire(gateway, %{"mode" => "LOITER"})
    held(gateway, "mode", "configuration")
  end

  test "a lost vehicle is held by its link, an expired field does not count", %{gateway: gateway} do
    vehicle = Store.vehicle(gateway, @vehicle)
    :ok = Store.put_vehicle(gateway, vehicle.key, %{vehicle | status: :lost})
    desire(gateway, %{"mode" => "LOITER"})
    assert %{why: "the vehicle is lost"} = held(gateway, "mode", "link")
    desire(gateway, %{"mode" => "LOITER"}, %{"expires_in_s" => 1})
    eventually(fn -> Shadow.report(gateway, @vehicle) == %{} end)
    assert {:ok, %{"desired" => desired, "set" => %{"mode" => _kept}}} = Shadow.get(gateway, @vehicle)
    assert desired == %{}
  end

  test "a message rate is wanted of the vehicle while it is desired", %{gateway: gateway} do
    desire(gateway, %{"intervals" => %{"ATTITUDE" => 10}})
    wanted = fn -> Aerie.Vehicle.Services.StreamDemand.merged(gateway, {"main", 7}).messages end
    eventually(fn -> wanted.()[30] == 10.0 end)
    desire(gateway, %{"intervals" => nil})
    eventually(fn -> wanted.() == %{} end)
  end

  test "the documents's restart costs nothing", %{gateway: gateway, loop: loop} do
    desire(gateway, %{"tags" => ["a"]})
    standing(gateway, "tags", :converged)
    Process.exit(documents(gateway), :kill)
    eventually(fn -> documents(gateway) != nil end)
    standing(gateway, "tags", :converged)
    assert Process.alive?(loop)
  end

  defp groups(gateway, groups) do
    vehicle = Store.vehicle(gateway, @vehicle)
    :ok = Store.put_vehicle(gateway, vehicle.key, %{vehicle | groups: Map.merge(vehicle.groups, groups)})
  end
end
