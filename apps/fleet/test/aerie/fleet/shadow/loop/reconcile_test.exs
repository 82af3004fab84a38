defmodule Aerie.Fleet.Shadow.Loop.ReconcileTest do
  @moduledoc "What is done about a difference, in which order, and when nothing is."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Shadow.{Document, Update}
  alias Aerie.Fleet.Shadow.Loop.{Attempts, Core, Reconcile}

  @now 1_800_000_000_000_000
  @second 1_000_000
  @jumps %{hour_forth: 3600 * @second, hour_back: -3600 * @second}
  @hash String.duplicate("0a", 32)

  defp desired(object) do
    {:ok, update} = Update.parse(%{"desired" => object}, @now)
    {:ok, document} = Document.apply(Document.new("V"), update, %{actor: "ops", via: "rest"}, @now)
    document.fields
  end

  defp actual(fields \\ %{}, more \\ []),
    do:
      Map.merge(
        %{fields: fields, mode: fields["mode"] || "GUIDED", armed: false, in_air: false},
        Map.new(more)
      )

  defp context(more \\ []) do
    Map.merge(
      %{
        now: @now,
        holds: [],
        attempts: Attempts.new(),
        busy: [],
        allow_arming: false
      },
      Map.new(more)
    )
  end

  defp reconcile(object, actual, context \\ context()),
    do: object |> desired() |> Reconcile.reconcile(actual, context)

  defp sets(actions), do: for({:set, path, _version, value} <- actions, do: {path, value})

  test "nothing is done about what is as desired" do
    assert {[], %{"mode" => %{state: :converged}}} =
             reconcile(%{"mode" => "loiter"}, actual(%{"mode" => "LOITER"}))

    assert Reconcile.reconcile(%{}, actual(), context()) == {[], %{}}
  end

  test "parameters before fence and home before mission before mode, one at a time" do
    all = %{
      "mode" => "LOITER",
      "mission" => %{"plan" => @hash},
      "home" => %{"lat" => 47, "lon" => 8, "altitude_msl" => 400},
      "geofence" => %{"enabled" => true},
      "params" => %{"A" => 1, "B" => 2}
    }

    {actions, report} = reconcile(all, actual())
    assert sets(actions) == [{"params.A", 1.0}]
    assert %{state: :pending, why: "being set"} = report["params.A"]
    assert %{state: :pending, why: "waits for its turn"} = report["params.B"]

    for path <- ~w(home geofence.enabled mission.plan mode),
        do: assert(%{state: :pending, why: "waits for params.A"} = report[path])

    order =
      Enum.reduce_while(1..10, {%{}, []}, fn _n, {fields, done} ->
        case reconcile(all, actual(fields)) do
          {[{:set, path, _version, value}], _report} -> {:cont, {Map.put(fields, path, value), [path | done]}}
          {[], _report} -> {:halt, Enum.reverse(done)}
        end
      end)

    assert order == ~w(params.A params.B geofence.enabled home mission.plan mode)
  end

  test "message rates, recorder and tags wait for nobody, and nobody waits for them" do
    {actions, _report} =
      reconcile(
        %{"intervals" => %{"ATTITUDE" => 10}, "recorder" => true, "mode" => "LOITER"},
        actual(),
        context()
      )

    assert sets(actions) == [{"intervals.ATTITUDE", 10.0}, {"recorder", true}, {"mode", "LOITER"}]
    hold = %{by: "rc", until: @now + @second, why: "a pilot flies it"}
    {actions, report} = reconcile(%{"recorder" => true, "mode" => "LOITER"}, actual(), context(holds: [hold]))
    assert sets(actions) == [{"recorder", true}]
    until = @now + @second
    assert %{state: :held, by: "rc", until: ^until, why: "a pilot flies it"} = report["mode"]
  end

  test "while one is being set, nothing else changes the vehicle" do
    {actions, report} = reconcile(%{"params" => %{"A" => 1, "B" => 2}}, actual(), context(busy: ["params.A"]))
    assert actions == []
    assert %{why: "being set"} = report["params.A"]
    assert %{why: "waits for its turn"} = report["params.B"]
  end

  describe "never lifts a vehicle off the ground" do
    test "armed on the ground: only modes that hold it or bring it down" do
      for in_air <- [false, nil], armed <- [true, nil] do
        standing = actual(%{"mode" => "STABILIZE"}, armed: armed, in_air: in_air)

        for mode <- ~w[AUTO GUIDED TAKEOFF AUTO_MISSION AUTO_TAKEOFF OFFBOARD THROW CIRCLE MODE(99)] do
          assert {[], %{"mode" => %{state: :held, by: "ground"}}} = reconcile(%{"mode" => mode}, standing)
        end

        for mode <- ~w(LAND RTL LOITER AUTO_LOITER BRAKE),
            do: assert({[{:set, "mode", 1, ^mode}], _report} = reconcile(%{"mode" => mode}, standing))
      end

      assert {[_set], _report} = reconcile(%{"mode" => "AUTO"}, actual(%{}, armed: true, in_air: true))
      assert {[_set], _report} = reconcile(%{"mode" => "AUTO"}, actual(%{}, armed: false))
    end

    test "armed: refused unless it is allowed; then only in a mode that waits for a pilot, and disarmed only on the ground" do
      for armed <- [true, false] do
        assert {[], %{"armed" => %{state: :refused, why: "shadow.allow_arming is false" <> _}}} =
                 reconcile(%{"armed" => armed}, actual(%{"armed" => not armed}))
      end

      allowed = context(allow_arming: true)

      for mode <- ["AUTO", "GUIDED", "AUTO_MISSION", nil] do
        off = %{fields: %{"armed" => false}, mode: mode, armed: false, in_air: false}
        assert {[], %{"armed" => %{state: :held, by: "ground"}}} = reconcile(%{"armed" => true}, off, allowed)
      end

      off = actual(%{"armed" => false, "mode" => "STABILIZE"})
      assert {[{:set, "armed", 1, true}], _report} = reconcile(%{"armed" => true}, off, allowed)

      for in_air <- [true, nil] do
        flying = actual(%{"armed" => true}, armed: true, in_air: in_air)

        assert {[], %{"armed" => %{state: :held, by: "air"}}} =
                 reconcile(%{"armed" => false}, flying, allowed)
      end

      standing = actual(%{"armed" => true}, armed: true)
      assert {[{:set, "armed", 1, false}], _report} = reconcile(%{"armed" => false}, standing, allowed)
    end

    test "a mission is not changed while it is flown, and keys are given on the ground" do
      flying = actual(%{"mode" => "AUTO"}, armed: true, in_air: true)

      assert {[], %{"mission.plan" => %{state: :held, by: "mission"}}} =
               reconcile(%{"mission" => %{"plan" => @hash}}, flying)

      assert {[], %{"signing" => %{state: :held, by: "armed"}}} = reconcile(%{"signing" => true}, flying)
    end
  end

  test "refusals: growing waits, then an end; setting it again or a restart of the vehicle begins again" do
    {waits, attempts} =
      Enum.map_reduce(1..6, Attempts.new(), fn _n, attempts ->
        attempts = Attempts.tried(attempts, "mode", 1, "the vehicle refused it", @now)
        {attempts.fields["mode"].next_at - @now, attempts}
      end)

    for {wait, n} <- Enum.with_index(waits, 1),
        do: assert(wait in (Integer.pow(2, n) * @second)..(Integer.pow(2, n + 1) * @second))

    assert {[], %{"mode" => %{state: :pending, until: until, why: "tried again later: the vehicle" <> _}}} =
             reconcile(%{"mode" => "LOITER"}, actual(), context(attempts: attempts))

    later = context(attempts: attempts, now: until)

    assert {[], %{"mode" => %{state: :refused, why: "6 tries; the vehicle refused it"}}} =
             reconcile(%{"mode" => "LOITER"}, actual(), later)

    assert Attempts.may(attempts, "mode", 2, until) == :go
    assert Attempts.may(Attempts.rebooted(attempts), "mode", 1, until) == :go
    assert attempts |> Attempts.agreed([], [], until) |> Attempts.may("mode", 1, until) == :go

    settled =
      attempts
      |> Attempts.agreed(["mode"], ["mode"], until)
      |> Attempts.agreed(["mode"], ["mode"], until + 601 * @second)

    assert settled.fields == %{}
  end

  # The loop's core before a vehicle that obeys, refuses, changes things back, and is flown by others now and then.
  describe "properties" do
    test "it converges when nothing resists, and then does nothing" do
      property =
        :proper.forall(wishes(), fn wishes ->
          {_core, _vehicle, log} = run(wishes, %{}, 60)
          {actions, last} = List.last(log)
          actions == [] and Enum.all?(last, fn {_path, status} -> status.state == :converged end)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 100]) == true, inspect(:proper.counterexample())
    end

    test "it sets each field once when the vehicle obeys, in the order of the stages" do
      property =
        :proper.forall(wishes(), fn wishes ->
          {_core, _vehicle, log} = run(wishes, %{}, 60)
          set = for {actions, _report} <- log, {:set, path, _version, _value} <- actions, do: path

          stages =
            for path <- set,
                stage = Aerie.Fleet.Shadow.Document.Field.fetch!(path).stage,
                stage > 0,
                do: stage

          set == Enum.uniq(set) and stages == Enum.sort(stages)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 100]) == true, inspect(:proper.counterexample())
    end

    test "it never acts on the vehicle while somebody is in charge, and for the configured time after" do
      property =
        :proper.forall({wishes(), disturbances()}, fn {wishes, disturbances} ->
          {_core, _vehicle, log} = run(wishes, disturbances, 120)

          acted =
            for {{actions, _report}, second} <- Enum.with_index(log),
                {:set, path, _version, _value} <- actions,
                Aerie.Fleet.Shadow.Document.Field.fetch!(path).permission != :telemetry,
                do: second

          Enum.all?(acted, fn second ->
            Enum.all?(
              max(second - 29, 0)..second,
              &(disturbances[&1] not in [:failsafe, :operator, :rc, :other])
            )
          end)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
    end

    test "after the last disturbance it settles: everything agrees or is given up, and nothing is done any more" do
      property =
        :proper.forall({wishes(), disturbances()}, fn {wishes, disturbances} ->
          {_core, _vehicle, log} = run(wishes, disturbances, 600)
          {_actions, last} = List.last(log)
          quiet? = log |> Enum.take(-60) |> Enum.all?(fn {actions, _report} -> actions == [] end)
          quiet? and Enum.all?(last, fn {_path, status} -> status.state in [:converged, :refused] end)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 40]) == true, inspect(:proper.counterexample())
    end

    test "it ends: a vehicle that refuses or changes everything back is left alone after six tries" do
      property =
        :proper.forall({wishes(), :proper_types.oneof([:refuse, :change_back])}, fn {wishes, how} ->
          {_core, _vehicle, log} = run(wishes, Map.new(0..1_200, &{&1, how}), 1_200)

          log
          |> Enum.flat_map(fn {actions, _report} ->
            for {:set, path, _version, _value} <- actions, do: path
          end)
          |> Enum.frequencies()
          |> Enum.all?(fn {_path, tries} -> tries <= 6 end)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 20]) == true, inspect(:proper.counterexample())
    end
  end

  # As pairs, for shrinking.
  defp wishes do
    wish =
      :proper_types.oneof([
        {"mode", :proper_types.oneof(["AUTO", "LOITER", "RTL"])},
        {"recorder", :proper_types.boolean()},
        {"tags", ["a"]},
        {"home", %{"lat" => 47, "lon" => 8, "altitude_msl" => 400}},
        {"params", :proper_types.oneof([%{"A" => 1}, %{"A" => 2, "B" => 3}])},
        {"geofence", %{"enabled" => true}},
        {"mission", %{"plan" => @hash}},
        {"intervals", %{"ATTITUDE" => 10}}
      ])

    :proper_types.bind(:proper_types.non_empty(:proper_types.list(wish)), &Map.new/1, false)
  end

  defp disturbances do
    what = :proper_types.oneof([:failsafe, :operator, :rc, :other, :hour_forth, :hour_back])
    :proper_types.bind(:proper_types.list({:proper_types.integer(0, 100), what}), &Map.new/1, false)
  end

  # A second a step. A vehicle that flies, so that every mode may be set; `disturbances` by second.
  defp run(wishes, disturbances, seconds) do
    {:ok, update} = Update.parse(%{"desired" => wishes}, @now)
    {:ok, document} = Document.apply(Document.new("V"), update, %{actor: "ops", via: "rest"}, @now)
    core = "V" |> Core.new(hold_us: 30 * @second, max_tries: 6, allow_arming: false) |> Core.desired(document)
    vehicle = %{fields: %{"mode" => "GUIDED"}, rc: 1500, commanded: nil, failsafe: false, jump: 0}
    # One look before it all begins: the first one knows nothing to compare with.
    {core, _actions} = Core.compare(%{core | document: Document.new("V")}, view(vehicle, @now - 60 * @second))
    core = Core.desired(core, document)

    {core, vehicle, log} =
      Enum.reduce(0..(seconds - 1), {core, vehicle, []}, fn second, {core, vehicle, log} ->
        jump = vehicle.jump + Map.get(@jumps, disturbances[second], 0)
        core = Core.clock_set(core, jump - vehicle.jump)
        now = @now + jump + second * @second
        vehicle = disturb(%{vehicle | jump: jump}, disturbances[second], now)
        {core, actions} = Core.compare(core, view(vehicle, now))
        {core, vehicle} = Enum.reduce(actions, {core, vehicle}, &obey(&1, &2, disturbances[second], now))
        {core, vehicle, [{actions -- reports(actions), core.report} | log]}
      end)

    {core, vehicle, Enum.reverse(log)}
  end

  defp reports(actions), do: Enum.filter(actions, &match?({:report, _report}, &1))

  defp disturb(vehicle, :failsafe, _now), do: %{vehicle | failsafe: true}

  defp disturb(vehicle, :operator, now),
    do: %{vehicle | failsafe: false, commanded: %{at: now, source: "ops", type: "hold"}}

  defp disturb(vehicle, :rc, _now), do: %{vehicle | failsafe: false, rc: 3000 - vehicle.rc + 100}

  defp disturb(vehicle, :other, _now),
    do: %{
      vehicle
      | failsafe: false,
        rc: 3000 - vehicle.rc + 100,
        fields: Map.put(vehicle.fields, "mode", "ALT_HOLD")
    }

  defp disturb(vehicle, :change_back, _now), do: %{vehicle | fields: %{"mode" => "GUIDED"}}
  defp disturb(vehicle, _none, _now), do: %{vehicle | failsafe: false}

  defp obey({:set, path, version, _value}, {core, vehicle}, :refuse, now),
    do: {Core.done(core, path, version, {:refused, "no"}, now), vehicle}

  defp obey({:set, path, version, value}, {core, vehicle}, _obeys, now),
    do:
      {Core.done(core, path, version, :done, now), %{vehicle | fields: Map.put(vehicle.fields, path, value)}}

  defp obey(_other, acc, _how, _now), do: acc

  defp view(vehicle, now) do
    mode = %{mode: vehicle.fields["mode"], armed: true, in_air: true, failsafe: vehicle.failsafe}

    %{
      now: now,
      snapshot: %Aerie.Vehicle.Snapshot{
        status: :online,
        time_boot_ms: div(now - vehicle.jump, 1000),
        groups: %{
          mode: %{data: mode},
          rc: %{data: %{channels: [vehicle.rc, 1500]}},
          health: %{data: %{rc_receiver: false}}
        }
      },
      commanded: vehicle.commanded,
      holds: [],
      beside: Map.drop(vehicle.fields, ["mode"])
    }
  end
end
