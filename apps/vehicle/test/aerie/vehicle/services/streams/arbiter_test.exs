defmodule Aerie.Vehicle.Services.Streams.ArbiterTest do
  use ExUnit.Case, async: true

  alias Aerie.StreamVehicle, as: Sim
  alias Aerie.Vehicle.Services.Streams.Arbiter

  @floor Arbiter.floor()
  @default Map.new(@floor, fn {id, _hz} -> {id, 2} end)

  defp requests(vehicle), do: for({at, what} <- Sim.sent(vehicle), elem(what, 0) != :once, do: {at, what})
  defp sets(vehicle, id), do: for({at, {:set, ^id, us}} <- Sim.sent(vehicle), do: {at, us})
  defp state(vehicle, id), do: Arbiter.show(vehicle.arbiter)[id].state
  defp after_s(list, seconds), do: for({at, what} <- list, at > seconds, do: {at, what})

  describe "what the gateway needs" do
    test "M3: a vehicle that sends it is asked for nothing but what comes only once" do
      vehicle = Sim.run(Sim.new(rates: @default), 600)
      assert requests(vehicle) == []
      assert for({_, what} <- Sim.sent(vehicle), do: what) == [{:once, 148}, {:once, 242}]
      assert Enum.all?(Arbiter.show(vehicle.arbiter), fn {_id, line} -> line.state == :ok end)
    end

    test "nothing is asked of a vehicle before it is heard" do
      assert {arbiter, [], []} = Arbiter.expire(Arbiter.new(), 1_000_000_000, {1, 1})
      assert arbiter == Arbiter.new()
    end

    test "M1: what is missing is asked for after a moment's grace, one command at a time" do
      vehicle = Sim.run(Sim.new(rates: Map.drop(@default, [245, 30])), 10)
      assert [{first, {:set, 30, 250_000.0}}, {second, {:set, 245, 500_000.0}}] = requests(vehicle)
      assert first >= 2 and second > first
      assert %{30 => %{state: :ok, asked: 4, wanted: nil}} = Arbiter.show(vehicle.arbiter)
    end

    test "M2: an acknowledgement is not needed, what is measured counts" do
      vehicle = Sim.run(Sim.new(acks: false), 30)
      assert vehicle |> requests() |> length() == map_size(@floor)
      assert Enum.all?(Arbiter.show(vehicle.arbiter), fn {_id, line} -> line.state == :ok end)
    end

    test "what never comes is tried three times, then left alone" do
      vehicle = Sim.run(Sim.new(rates: Map.delete(@default, 65), command: :ignored), 600)
      assert [a, b, c] = vehicle |> sets(65) |> Enum.map(&elem(&1, 0))
      assert b - a >= 3 and c - b >= 10 and c < 20
      assert state(vehicle, 65) == :missing
    end

    test "what the vehicle does not have is tried once" do
      vehicle = Sim.run(Sim.new(rates: Map.delete(@default, 65), knows: [30]), 600)
      assert [_one] = sets(vehicle, 65)
      assert state(vehicle, 65) == :missing
    end

    test "M3: what stopped is asked for again, once, and what stops again is left" do
      vehicle = Sim.run(Sim.new(rates: @default), 60)
      vehicle = vehicle |> Sim.set(33, 0) |> Sim.run(60)
      assert [{at, 250_000.0}] = sets(vehicle, 33)
      assert at >= 70 and at <= 76
      vehicle = vehicle |> Sim.set(33, 0) |> Sim.run(30) |> Sim.set(33, 0) |> Sim.run(600)
      assert length(sets(vehicle, 33)) == 2
      assert state(vehicle, 33) == :yielded
      assert [%{id: 33, how: :slower, yielded: true}] = vehicle.notices
    end
  end

  describe "REQUEST_DATA_STREAM" do
    test "M1: in place of a command that the vehicle does not know" do
      vehicle = Sim.run(Sim.new(command: :unsupported), 60)
      assert [_once] = for({_, {:set, _, _}} = one <- requests(vehicle), do: one)
      assert %{state: :ok} = Arbiter.show(vehicle.arbiter)[30]
      groups = for {_, {:group, id, hz}} <- requests(vehicle), do: {id, hz}
      assert Enum.sort(groups) == [{2, 1}, {3, 1}, {6, 4}, {10, 4}, {11, 2}, {12, 1}]
    end

    test "M1: when commands are neither heeded nor acknowledged; then it is left alone" do
      vehicle = Sim.run(Sim.new(command: :ignored), 600)
      assert %{state: :ok} = Arbiter.show(vehicle.arbiter)[30]
      assert vehicle |> requests() |> after_s(60) == []
    end

    test "and a vehicle that heeds nothing at all is left alone too" do
      vehicle = Sim.run(Sim.new(command: :ignored, old: false), 600)
      assert vehicle |> requests() |> after_s(90) == []
      assert length(requests(vehicle)) < 60
    end
  end

  describe "what clients want" do
    test "the highest rate of each message counts, and what comes by itself is not asked for" do
      vehicle = Sim.new(rates: @default, gateway: %{30 => 10}) |> Sim.run(30)
      assert [{_, {:set, 30, 100_000.0}}] = requests(vehicle)
      vehicle = vehicle |> Sim.want(%{30 => 5, 33 => 2, 74 => 8}) |> Sim.run(30)
      assert [_, {_, {:set, 74, 125_000.0}}] = requests(vehicle)
      assert %{wanted: 10, asked: 10, state: :ok, measured: rate} = Arbiter.show(vehicle.arbiter)[30]
      assert_in_delta rate, 10, 1
    end

    test "a message that nobody else needs, and its end: the vehicle's default again, after a while" do
      vehicle = Sim.new(rates: @default) |> Sim.run(10) |> Sim.want(%{36 => 5}) |> Sim.run(10)
      assert [{_, {:set, 36, 200_000.0}}] = requests(vehicle)
      vehicle = vehicle |> Sim.want(%{}) |> Sim.run(5)
      assert length(requests(vehicle)) == 1
      vehicle = Sim.run(vehicle, 60)
      assert [_, {_, {:set, 36, +0.0}}] = requests(vehicle)
      refute is_map_key(Arbiter.show(vehicle.arbiter), 36)
    end

    test "a client that wants less again gets less, but never less than somebody else wants" do
      vehicle = Sim.new(rates: @default) |> Sim.run(10) |> Sim.want(%{30 => 20}) |> Sim.run(10)
      vehicle = vehicle |> Sim.want(%{30 => 6}) |> Sim.run(60)
      assert [50_000.0, 166_666.0] = vehicle |> sets(30) |> Enum.map(&elem(&1, 1))
      vehicle = vehicle |> Sim.want(%{}) |> Sim.run(60)
      assert [_, _, interval] = vehicle |> sets(30) |> Enum.map(&elem(&1, 1))
      assert_in_delta interval, 500_000, 50_000
    end

    test "M2: the rate before the first request is restored when no client wants more" do
      vehicle = Sim.new(rates: %{@default | 30 => 50}) |> Sim.run(20)
      # The client's own request, which is forwarded, with a lower rate.
      for hz <- [100, 20, 2] do
        asked = vehicle |> Sim.set(30, hz) |> Sim.want(%{30 => hz}, forwarded: 30) |> Sim.run(30)
        assert asked.rates[30] == hz
        left = asked |> Sim.want(%{}) |> Sim.run(60)
        assert_in_delta left.rates[30], 50, 2
        assert [_once] = sets(left, 30)
        # It stays so, and is not reported as contested.
        again = Sim.run(left, 120)
        assert {length(sets(again, 30)), again.notices, state(again, 30)} == {1, [], :ok}
      end
    end

    test "another client's demand does not keep it below its initial rate" do
      vehicle = Sim.new(rates: %{@default | 30 => 50}) |> Sim.run(20)
      vehicle = vehicle |> Sim.want(%{30 => 100}) |> Sim.run(20) |> Sim.want(%{30 => 6}) |> Sim.run(60)
      assert_in_delta vehicle.rates[30], 50, 2
    end

    test "a message that was not measured before the first request gets the vehicle's default" do
      vehicle = Sim.new(rates: %{@default | 30 => 50}) |> Sim.run(0.5)
      vehicle = vehicle |> Sim.want(%{30 => 100}, forwarded: 30) |> Sim.set(30, 100) |> Sim.run(10)
      vehicle = vehicle |> Sim.want(%{}) |> Sim.run(60)
      assert [{_, +0.0}] = sets(vehicle, 30)
      assert {vehicle.rates[30], vehicle.notices} == {50, []}
    end

    test "what the gateway had to request keeps the rate that it requests" do
      vehicle =
        Sim.new(rates: Map.delete(@default, 30)) |> Sim.run(20) |> Sim.want(%{30 => 20}) |> Sim.run(20)

      vehicle = vehicle |> Sim.want(%{}) |> Sim.run(60)
      assert {vehicle.rates[30], state(vehicle, 30)} == {4.0, :ok}
    end

    test "a forwarded request is judged before it is repeated" do
      vehicle = Sim.new(rates: @default) |> Sim.run(10)
      obeyed = vehicle |> Sim.set(30, 10) |> Sim.want(%{30 => 10}, forwarded: 30) |> Sim.run(30)
      assert requests(obeyed) == []
      lost = vehicle |> Sim.want(%{30 => 10}, forwarded: 30) |> Sim.run(30)
      assert [{_, {:set, 30, 100_000.0}}] = requests(lost)
    end

    test "groups are requested once, and higher rates in them are restored" do
      vehicle = Sim.new(rates: @default) |> Sim.run(5) |> Sim.want(%{30 => 20}) |> Sim.run(20)
      vehicle = vehicle |> Sim.want(%{30 => 20}, groups: %{10 => 4, 11 => 4}) |> Sim.run(120)
      assert vehicle.rates[30] == 20 and vehicle.rates[178] == 4 and vehicle.rates[74] == 4
      assert length(for({_, {:group, _, _}} = one <- requests(vehicle), do: one)) == 2
      assert vehicle.notices == []
    end

    test "M2: what the members of a group had before is restored when no client wants the group any more" do
      before = Sim.new(rates: %{@default | 30 => 10}) |> Sim.run(20)

      for hz <- [4, 2, 20] do
        asked = before |> Sim.want(%{}, groups: %{10 => hz}) |> Sim.run(30)
        assert {asked.rates[30], asked.rates[178]} == {hz, hz}
        left = asked |> Sim.want(%{}) |> Sim.run(60)
        assert_in_delta left.rates[30], 10, 1
        # Nobody had asked for AHRS2, and it did not come.
        assert left.rates[178] == 0
        again = Sim.run(left, 120)
        assert {requests(again), again.notices, state(again, 30)} == {requests(left), [], :ok}
      end
    end

    test "M2: also of members that nobody wants, with the group's own request" do
      rates = Map.merge(@default, %{30 => 10, 178 => 10, 27 => 5, 116 => 5})
      vehicle = Sim.new(rates: rates) |> Sim.run(20)
      vehicle = vehicle |> Sim.want(%{}, groups: %{1 => 4, 10 => 4}) |> Sim.run(30)
      assert {vehicle.rates[30], vehicle.rates[178], vehicle.rates[27]} == {4, 4, 4}
      left = vehicle |> Sim.want(%{}) |> Sim.run(60)
      assert Map.take(left.rates, [30, 178, 27, 116]) == %{30 => 10, 178 => 10, 27 => 5, 116 => 5}

      assert [{:group, 1, 5}, {:group, 10, 10}] =
               left |> requests() |> Enum.map(&elem(&1, 1)) |> Enum.take(-2)
    end

    test "a group that other clients want is lowered to the rate that they want, not below what came before" do
      vehicle = Sim.new(rates: Map.put(@default, 178, 3)) |> Sim.run(20)
      vehicle = vehicle |> Sim.want(%{}, groups: %{10 => 10}) |> Sim.run(20)
      assert vehicle.rates[178] == 10
      assert (vehicle |> Sim.want(%{}, groups: %{10 => 5}) |> Sim.run(30)).rates[178] == 5
      assert (vehicle |> Sim.want(%{}, groups: %{10 => 1}) |> Sim.run(30)).rates[178] == 3
    end

    test "a group's end takes nothing from a client that wants one of its messages" do
      vehicle = Sim.new(rates: %{@default | 30 => 10}) |> Sim.run(20)
      vehicle = vehicle |> Sim.want(%{30 => 20, 178 => 6}, groups: %{10 => 4}) |> Sim.run(30)
      vehicle = vehicle |> Sim.want(%{30 => 20, 178 => 6}) |> Sim.run(60)
      assert_in_delta vehicle.rates[30], 20, 0.1
      assert_in_delta vehicle.rates[178], 6, 0.1
    end

    test "a client that is gone for a moment only changes nothing" do
      vehicle = Sim.new(rates: @default) |> Sim.run(20) |> Sim.want(%{}, groups: %{10 => 4}) |> Sim.run(20)
      back = vehicle |> Sim.want(%{}) |> Sim.run(5) |> Sim.want(%{}, groups: %{10 => 4}) |> Sim.run(60)
      assert requests(back) == requests(vehicle)
    end

    test "M2: a vehicle that knows only REQUEST_DATA_STREAM gets its rates back too" do
      before = Sim.new(rates: Map.merge(@default, %{30 => 10, 27 => 5}), command: :unsupported) |> Sim.run(20)
      # It has refused the command once.
      before = before |> Sim.want(%{33 => 5}) |> Sim.run(20)
      asked = before |> Sim.want(%{33 => 5}, groups: %{1 => 2, 10 => 4}) |> Sim.run(30)
      assert {asked.rates[27], asked.rates[30]} == {2, 4}
      left = asked |> Sim.want(%{33 => 5}) |> Sim.run(60)
      assert {left.rates[27], left.rates[30], left.rates[33]} == {5, 10, 5}
    end

    test "M2: a change of the clock does not prevent it" do
      vehicle = Sim.new(rates: %{@default | 30 => 10}) |> Sim.run(20)

      vehicle =
        vehicle |> Sim.want(%{36 => 2}, groups: %{10 => 4}) |> Sim.run(20) |> Sim.want(%{}) |> Sim.run(2)

      vehicle = %{vehicle | now: 0, arbiter: Arbiter.rebased(vehicle.arbiter, 0)} |> Sim.run(60)
      assert {vehicle.rates[30], vehicle.rates[36]} == {10, 0}
    end

    test "a member that is not wanted any more does not hold its group up" do
      vehicle = Sim.new(rates: @default) |> Sim.run(20)
      vehicle = vehicle |> Sim.want(%{178 => 1}, groups: %{10 => 4}) |> Sim.run(2)
      vehicle = vehicle |> Sim.want(%{}, groups: %{10 => 4}) |> Sim.run(20)
      assert vehicle.rates[178] == 4
      assert (vehicle |> Sim.want(%{}) |> Sim.run(60)).rates[178] == 0
    end

    test "nothing is measured while nothing may be sent" do
      vehicle = Sim.new(rates: Map.put(@default, 27, 5)) |> Sim.run(20)
      held = %{vehicle | arbiter: Arbiter.hold(vehicle.arbiter, true), rates: %{}}
      held = held |> Sim.want(%{}, groups: %{1 => 2}) |> Sim.run(30)
      vehicle = %{held | arbiter: Arbiter.hold(held.arbiter, false), rates: vehicle.rates} |> Sim.run(30)
      assert vehicle.rates[27] == 2
      assert (vehicle |> Sim.want(%{}) |> Sim.run(60)).rates[27] == 5
    end

    test "R6: after a reboot everything that does not come is requested again" do
      vehicle = Sim.new(rates: @default) |> Sim.run(5)
      vehicle = vehicle |> Sim.want(%{30 => 20}, groups: %{11 => 4}) |> Sim.run(30)
      vehicle = vehicle |> Sim.reboot(Map.delete(@default, 245)) |> Sim.run(30)
      later = vehicle |> requests() |> after_s(36) |> Enum.map(&elem(&1, 1)) |> Enum.sort()
      assert later == [{:group, 11, 4}, {:set, 30, 50_000.0}, {:set, 245, 500_000.0}]
    end

    test "a rate that the vehicle cannot reach is requested three times" do
      vehicle = Sim.new(rates: @default, gateway: %{30 => 50}, cap: 20) |> Sim.run(300)
      assert length(sets(vehicle, 30)) <= 3
      assert state(vehicle, 30) == :short
    end
  end

  describe "other programs" do
    test "a slow link is not taken for another program: no request, no report" do
      vehicle = Sim.new(gateway: %{30 => 10, 33 => 5, 74 => 5}) |> Sim.run(60)
      asked = length(requests(vehicle))
      vehicle = Sim.run(%{vehicle | carried: 0.4}, 300)
      assert vehicle |> requests() |> Enum.drop(asked) |> Enum.all?(&match?({_, {:query, _}}, &1))
      assert state(vehicle, 30) == :short
      assert vehicle.notices == []
      assert Sim.run(%{vehicle | carried: 1.0}, 60) |> state(30) == :ok
    end

    test "M2: a rate that is lowered once is corrected once; lowered again, it is left to the other program and reported once" do
      vehicle = Sim.new(rates: @default, gateway: %{30 => 10}) |> Sim.run(30)
      vehicle = vehicle |> Sim.set(30, 2) |> Sim.run(30)
      assert length(sets(vehicle, 30)) == 2
      assert {vehicle.notices, state(vehicle, 30)} == {[], :ok}
      vehicle = Sim.run(vehicle, 600, &Sim.set(&1, 30, 2))
      assert length(sets(vehicle, 30)) == 2
      assert state(vehicle, 30) == :yielded
      assert [%{id: 30, asked: 10, how: :slower, yielded: true}] = vehicle.notices
    end

    test "if the vehicle does not tell its interval, it is corrected once, and nobody is blamed" do
      vehicle = Sim.new(rates: @default, gateway: %{30 => 10}, tells: false) |> Sim.run(30)
      vehicle = Sim.run(vehicle, 600, &Sim.set(&1, 30, 2))
      assert length(sets(vehicle, 30)) == 2
      assert {state(vehicle, 30), vehicle.notices} == {:short, []}
    end

    test "M2: a link of ours that loses data is not another program, whatever it loses" do
      for carried <- [0.05, 0.2, 0.4, 0.55, 0.8],
          loss <- [0.2, 0.5, 0.9],
          wants <- [%{30 => 10}, %{30 => 10, 33 => 5}] do
        vehicle = Sim.new(rates: @default, gateway: wants) |> Sim.run(60)
        vehicle = Sim.run(%{vehicle | carried: carried, loss: loss}, 900)
        assert {carried, loss, vehicle.notices} == {carried, loss, []}
        refute :yielded in Enum.map(Map.keys(wants), &state(vehicle, &1))
        assert Sim.run(%{vehicle | carried: 1.0, loss: 0.0}, 120) |> state(30) == :ok
      end
    end

    test "nor is one that makes up for a pause" do
      vehicle = Sim.new(rates: @default, gateway: %{30 => 10}) |> Sim.run(30)

      vehicle =
        for(_ <- 1..20, carried <- [0.8, 1.9], do: carried)
        |> Enum.reduce(vehicle, &Sim.run(%{&2 | carried: &1}, 6))

      assert vehicle.notices == []
      assert Sim.run(%{vehicle | carried: 1.0}, 60) |> state(30) == :ok
    end

    test "a rate that another program raised is reported and left" do
      vehicle = Sim.new(rates: @default, gateway: %{30 => 10}) |> Sim.run(30)
      vehicle = vehicle |> Sim.set(30, 20) |> Sim.run(120)
      assert length(sets(vehicle, 30)) == 1
      assert [%{id: 30, how: :faster, asked: 10, measured: 20.0}] = vehicle.notices
    end

    test "two links that bring the same frames do not double the rate" do
      arbiter = Arbiter.new(%{30 => 10}) |> Arbiter.received("a", 30, 0)
      # Five a second by each of two links.
      arbiter =
        Enum.reduce(1..200, arbiter, fn n, arbiter ->
          arbiter = Arbiter.received(arbiter, "a", 30, n * 200_000)
          arbiter = Arbiter.received(arbiter, "b", 30, n * 200_000)
          {arbiter, _messages, _notices} = Arbiter.expire(arbiter, n * 200_000, {1, 1})
          arbiter
        end)

      assert_in_delta Arbiter.show(arbiter)[30].measured, 5, 0.7
    end

    test "a silence is not a low rate" do
      vehicle = Sim.new(rates: @default, gateway: %{30 => 10}) |> Sim.run(30)
      before = requests(vehicle)
      vehicle = Sim.run(%{vehicle | up: false}, 300)
      vehicle = %{vehicle | up: true, arbiter: Arbiter.back(vehicle.arbiter, vehicle.now)} |> Sim.run(60)
      assert requests(vehicle) == before
    end
  end

  describe "properties" do
    defp id, do: :proper_types.oneof([30, 33, 74, 1, 36, 241])

    defp groups, do: :proper_types.list({:proper_types.oneof([1, 2, 6, 10, 13]), :proper_types.range(1, 40)})

    defp step do
      :proper_types.frequency([
        {3, {:want, :proper_types.list({id(), :proper_types.range(1, 40)}), groups()}},
        {2, {:other, id(), :proper_types.range(0, 50)}},
        {1, :reboot},
        {1, {:link, :proper_types.oneof([0.3, 0.8, 1.0])}},
        {4, {:wait, :proper_types.range(1, 40)}}
      ])
    end

    defp apply_step({:want, wants, groups}, vehicle),
      do: Sim.want(vehicle, Map.new(wants), groups: Map.new(groups))

    defp apply_step({:other, id, hz}, vehicle), do: Sim.set(vehicle, id, hz)
    defp apply_step(:reboot, vehicle), do: Sim.reboot(vehicle, @default)
    defp apply_step({:link, share}, vehicle), do: %{vehicle | carried: share}
    defp apply_step({:wait, seconds}, vehicle), do: Sim.run(vehicle, seconds)

    defp behaviour do
      :proper_types.oneof([
        [],
        [acks: false],
        [tells: false],
        [command: :ignored],
        [command: :unsupported],
        [command: :failed]
      ])
    end

    test "whatever happened: requests end when nothing more happens, and are never a flood" do
      prop =
        :proper.forall({behaviour(), :proper_types.list(step())}, fn {behaviour, steps} ->
          vehicle = Enum.reduce(steps, Sim.new([rates: @default] ++ behaviour), &apply_step/2)
          vehicle = Sim.run(vehicle, 200)
          quiet = Sim.run(vehicle, 120)
          # Never two commands at once.
          gaps = for [{a, _}, {b, _}] <- Enum.chunk_every(Sim.sent(quiet), 2, 1, :discard), do: b - a
          length(Sim.sent(quiet)) == length(Sim.sent(vehicle)) and Enum.all?(gaps, &(&1 > 0))
        end)

      assert :proper.quickcheck(prop, [:quiet, numtests: 60]) == true, inspect(:proper.counterexample())
    end

    test "a vehicle that obeys, without other programs, finally sends what is wanted" do
      prop =
        :proper.forall(
          {:proper_types.list({id(), :proper_types.range(1, 19)}),
           :proper_types.list({id(), :proper_types.range(1, 19)})},
          fn {first, second} ->
            vehicle = Sim.new(rates: @default) |> Sim.run(10) |> Sim.want(Map.new(first)) |> Sim.run(30)
            vehicle = vehicle |> Sim.want(Map.new(second)) |> Sim.run(120)

            Enum.all?(Map.new(second), fn {id, hz} ->
              vehicle.rates[id] >= hz * 0.7 and state(vehicle, id) == :ok
            end) and vehicle.notices == []
          end
        )

      assert :proper.quickcheck(prop, [:quiet, numtests: 60]) == true, inspect(:proper.counterexample())
    end

    test "M2: whatever clients wanted of a vehicle that obeys: when they are gone, it sends what it sent before" do
      prop =
        :proper.forall(
          {:proper_types.range(1, 20), :proper_types.range(0, 20),
           :proper_types.list({:proper_types.list({id(), :proper_types.range(1, 40)}), groups()})},
          fn {attitude, raw, wants} ->
            # As with ArduPilot, the members of a group that nobody has requested have one rate.
            rates = Map.merge(@default, Map.new([26, 27, 29], &{&1, raw}))
            before = Sim.new(rates: %{rates | 30 => attitude}) |> Sim.run(20)

            left =
              Enum.reduce(wants, before, fn {messages, groups}, vehicle ->
                vehicle |> Sim.want(Map.new(messages), groups: Map.new(groups)) |> Sim.run(15)
              end)

            left = left |> Sim.want(%{}) |> Sim.run(60)
            known = Map.filter(before.rates, fn {id, _hz} -> id in [26, 27, 29 | Map.keys(@floor)] end)

            left.notices == [] and
              Enum.all?(known, fn {id, hz} -> abs(left.rates[id] - hz) <= max(0.5, hz * 0.1) end)
          end
        )

      assert :proper.quickcheck(prop, [:quiet, numtests: 60]) == true, inspect(:proper.counterexample())
    end

    test "a program that sets a rate again and again is corrected at most once" do
      prop =
        :proper.forall({id(), :proper_types.range(10, 40), :proper_types.range(1, 5)}, fn {id, wanted, theirs} ->
          vehicle = Sim.new(rates: @default, gateway: %{id => wanted}) |> Sim.run(30)
          vehicle = Sim.run(vehicle, 300, &Sim.set(&1, id, theirs))
          length(sets(vehicle, id)) <= 3 and state(vehicle, id) == :yielded
        end)

      assert :proper.quickcheck(prop, [:quiet, numtests: 30]) == true, inspect(:proper.counterexample())
    end
  end
end
