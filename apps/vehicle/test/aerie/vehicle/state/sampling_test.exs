defmodule Aerie.Vehicle.State.SamplingTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.State.Sampling
  alias Aerie.Vehicle.State.Sampling.Mean

  @second 1_000_000

  # Pushes {seconds, data} and expires where data is nil; what came out, as {seconds, data}.
  defp run(group, settings, inputs) do
    {samples, _} =
      Enum.flat_map_reduce(inputs, Sampling.new(%{group => settings}), fn
        {seconds, nil}, samplers ->
          {samplers, due} = Sampling.expire(samplers, round(seconds * @second))
          {for({^group, sample} <- due, do: sample), samplers}

        {seconds, data}, samplers ->
          {samplers, due} = Sampling.push(samplers, group, round(seconds * @second), data)
          {due, samplers}
      end)

    for {at, data} <- samples, do: {at / @second, data}
  end

  describe "time" do
    test "what lacks a field waits for its period; the first whole value is given at once" do
      height = %{lat: nil, alt_rel: 1.0}
      place = %{lat: 47.0, alt_rel: 3.0}

      assert [{0.1, ^place}, {_, %{alt_rel: 3.0}}] =
               run(:position, %{strategy: :time}, [{0, height}, {0.1, place}, {0.2, place}, {1.2, nil}])

      assert [{_, %{lat: nil, alt_rel: 1.0}}] = run(:position, %{strategy: :time}, [{0, height}, {1.1, nil}])
    end

    test "the first value at once, then the mean of each period; at is that of the last value in it" do
      inputs = for n <- 0..25, do: {n / 10, %{alt_rel: n * 1.0}}

      assert [{+0.0, %{alt_rel: +0.0}}, {0.9, %{alt_rel: first}}, {1.9, %{alt_rel: second}}] =
               run(:position, %{strategy: :time, hz: 1.0}, inputs)

      assert_in_delta first, 5.0, 1.0e-9
      assert_in_delta second, 14.5, 1.0e-9
    end

    test "a value that stays the same is exactly that" do
      for value <- [0.1, 47.3977415, 149.1652299, -35.363261] do
        inputs = for n <- 0..30, do: {n / 10, %{lat: value, lon: value, heading: 350.01}}

        for {_, data} <- run(:position, %{strategy: :time}, inputs),
            do: assert(data == %{lat: value, lon: value, heading: 350.01})
      end
    end

    test "angles are averaged on the circle" do
      inputs = [
        {0, %{}},
        {0.1, %{heading: 350.0, yaw: 170.0}},
        {0.5, %{heading: 20.0, yaw: -170.0}},
        {1.0, nil}
      ]

      assert [_, {_, %{heading: heading, yaw: yaw}}] = run(:attitude, %{strategy: :time}, inputs)
      assert_in_delta heading, 5.0, 1.0e-6
      assert_in_delta abs(yaw), 180.0, 1.0e-6
    end

    test "a vehicle that crosses the date line is not at Greenwich" do
      inputs = [{0, %{}}, {0.1, %{lon: 179.9999}}, {0.5, %{lon: -179.9999}}, {1.0, nil}]
      assert [_, {_, %{lon: lon}}] = run(:position, %{strategy: :time}, inputs)
      assert_in_delta abs(lon), 180.0, 1.0e-6
    end

    test "unknown values are left out; what is not a number is the last" do
      inputs = [
        {0, %{}},
        {0.1, %{alt_rel: nil, x: "a"}},
        {0.2, %{alt_rel: 2.0, x: "b"}},
        {0.4, %{alt_rel: 4.0, x: "c"}},
        {1, nil}
      ]

      assert run(:position, %{strategy: :time}, inputs) == [{0.0, %{}}, {0.4, %{alt_rel: 3.0, x: "c"}}]
      assert [{_, %{alt_rel: nil}}] = run(:position, %{strategy: :time}, [{0, %{alt_rel: nil}}, {1, nil}])
    end

    test "a period without values gives nothing, and periods begin again after a pause" do
      inputs = [{0, %{a: 1.0}}, {1, nil}, {2, nil}, {7.3, %{a: 5.0}}, {8.2, nil}, {8.3, nil}]
      assert run(:position, %{strategy: :time}, inputs) == [{0.0, %{a: 1.0}}, {7.3, %{a: 5.0}}]
    end
  end

  describe "change" do
    test "only what differs, and not too often; the last one is never lost" do
      settings = %{strategy: :change, hz: 1.0, refresh_s: 0}

      inputs = [
        {0, %{m: "A"}},
        {0.1, %{m: "A"}},
        {0.2, %{m: "B"}},
        {0.4, %{m: "C"}},
        {0.9, nil},
        {1.0, nil},
        {5, %{m: "C"}}
      ]

      assert run(:mode, settings, inputs) == [{0.0, %{m: "A"}}, {0.4, %{m: "C"}}]
    end

    test "one that changed back within the period is nothing" do
      settings = %{strategy: :change, hz: 1.0}

      assert run(:mode, settings, [{0, %{m: "A"}}, {0.2, %{m: "B"}}, {0.4, %{m: "A"}}, {2, nil}]) == [
               {0.0, %{m: "A"}}
             ]
    end

    test "what stays is given again after refresh_s, but only when it comes again" do
      settings = %{strategy: :change, hz: 1.0, refresh_s: 10.0}
      same = for n <- 0..25, do: {n, %{m: "A"}}
      assert run(:mode, settings, same) == [{0.0, %{m: "A"}}, {10.0, %{m: "A"}}, {20.0, %{m: "A"}}]
      assert run(:mode, settings, [{0, %{m: "A"}}, {60, nil}, {90, nil}]) == [{0.0, %{m: "A"}}]
    end
  end

  describe "threshold" do
    @settings %{
      strategy: :threshold,
      hz: 1.0,
      threshold: %{"remaining" => 0.01, "no such key" => 1},
      refresh_s: 0
    }

    test "by the amount a named number moved since the value given last, rounding or not" do
      inputs =
        for {remaining, n} <- Enum.with_index([0.58, 0.579, 0.575, 0.57, 0.565, 0.57, 0.55]),
            do: {n * 2, %{remaining: remaining, voltage: n}}

      assert Enum.map(run(:battery, @settings, inputs), fn {_, data} -> data.remaining end) == [
               0.58,
               0.57,
               0.55
             ]
    end

    test "becoming known or unknown counts" do
      inputs = [
        {0, %{remaining: nil}},
        {2, %{remaining: 0.5}},
        {4, %{remaining: 0.5}},
        {6, %{remaining: nil}}
      ]

      assert length(run(:battery, @settings, inputs)) == 3
    end
  end

  test "aggregate: mean, least, greatest, how many" do
    inputs = [
      {0, %{frames_per_s: 5.0, links: []}},
      {0.5, %{frames_per_s: 10.0, links: ["a"]}},
      {1, %{frames_per_s: 20.0, links: ["b"]}},
      {5, nil}
    ]

    assert run(:link, %{strategy: :aggregate, hz: 0.2}, inputs) == [
             {0.0,
              %{
                frames_per_s: 5.0,
                links: [],
                min: %{frames_per_s: 5.0},
                max: %{frames_per_s: 5.0},
                samples: 1
              }},
             {1.0,
              %{
                frames_per_s: 15.0,
                links: ["b"],
                min: %{frames_per_s: 10.0},
                max: %{frames_per_s: 20.0},
                samples: 2
              }}
           ]
  end

  test "every group has a strategy by default; settings change parts of it" do
    samplers = Sampling.new(%{position: %{hz: 5.0}})
    assert Enum.sort(Map.keys(samplers)) == Enum.sort(Keyword.keys(Aerie.Vehicle.State.Groups.keys()))
    assert {Sampling.Time, %{period_us: 200_000}} = samplers.position
    assert {Sampling.Gate, %{limits: nil}} = samplers.mode
    assert {Sampling.Gate, %{limits: [remaining: _]}} = samplers.battery
  end

  describe "properties" do
    defp values, do: :proper_types.non_empty(:proper_types.list(:proper_types.float(-1.0e6, 1.0e6)))
    defp angles, do: :proper_types.non_empty(:proper_types.list(:proper_types.float(0.0, 359.999)))

    defp mean(key, values) do
      values
      |> Enum.with_index()
      |> Enum.reduce(Mean.new(), fn {v, n}, m -> Mean.add(m, n, %{key => v}) end)
      |> Mean.result()
      |> Map.fetch!(key)
    end

    test "a mean lies within its values" do
      prop =
        :proper.forall(values(), fn values ->
          mean(:a, values) >= Enum.min(values) and mean(:a, values) <= Enum.max(values)
        end)

      assert :proper.quickcheck(prop, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
    end

    test "a mean angle turns with its values and is an angle" do
      prop =
        :proper.forall({angles(), :proper_types.float(0.0, 359.0)}, fn {angles, turn} ->
          mean = mean(:heading, angles)
          # Values all around the circle have a mean of no meaning.
          {x, y} =
            Enum.reduce(angles, {0.0, 0.0}, fn a, {x, y} ->
              {x + :math.cos(a * 0.0174532925), y + :math.sin(a * 0.0174532925)}
            end)

          turned = mean(:heading, Enum.map(angles, &:math.fmod(&1 + turn, 360.0)))
          difference = :math.fmod(turned - mean - turn + 720.0 + 180.0, 360.0) - 180.0
          mean >= 0.0 and mean <= 360.0 and (x * x + y * y < 1.0e-3 or abs(difference) < 1.0e-3)
        end)

      assert :proper.quickcheck(prop, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
    end

    test "no strategy gives more than its rate, and none gives a value of another time" do
      prop =
        :proper.forall(
          {:proper_types.oneof([:time, :change, :threshold, :aggregate]),
           :proper_types.list({:proper_types.range(0, 700_000), :proper_types.oneof([1, 2, 3, nil])})},
          fn {strategy, steps} ->
            settings = %{strategy: strategy, hz: 2.0, threshold: %{"remaining" => 1}, refresh_s: 0}

            {inputs, last} =
              Enum.map_reduce(steps, 0, fn {gap, value}, at ->
                {{(at + gap) / @second, %{remaining: value}}, at + gap}
              end)

            # Ticks in between, as the session has them.
            ticks = for at <- 0..(last + @second)//100_000, do: {at / @second, nil}

            samples =
              run(:battery, settings, Enum.sort_by(inputs ++ ticks, fn {at, data} -> {at, data == nil} end))

            times = Enum.map(inputs, &elem(&1, 0))
            span = (last + @second) / @second

            length(samples) <= span * 2 + 2 and Enum.all?(samples, fn {at, _} -> at in times end)
          end
        )

      assert :proper.quickcheck(prop, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
    end
  end
end
