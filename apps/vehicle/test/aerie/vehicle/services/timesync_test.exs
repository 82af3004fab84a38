defmodule Aerie.Vehicle.Services.TimesyncTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Services.Timesync
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @start 1_700_000_000_000_000

  # Asks for `seconds`; the vehicle's clock is ours plus `offset`, and `delays` returns the delay there and back at a second.
  defp run(sync \\ Timesync.new(10 * @second), seconds, offset, delays) do
    Enum.reduce(seconds, sync, fn second, sync ->
      now = @start + second * @second
      {sync, requests} = Timesync.expire(sync, now)

      requests = for {nil, %M.Timesync{} = request} <- requests, do: request

      Enum.reduce(requests, sync, fn %{tc1: 0, ts1: ts1}, sync ->
        {there, back} = delays.(second)
        reply(sync, %M.Timesync{tc1: (now + there + offset) * 1000, ts1: ts1}, now + there + back)
      end)
    end)
  end

  defp reply(sync, answer, at), do: sync |> Timesync.reply(answer, at) |> elem(0)
  defp now(second), do: @start + second * @second

  test "nothing is known before the first answer" do
    sync = Timesync.new(10 * @second)
    assert Timesync.offset(sync, @start) == nil
    assert %{offset_us: nil, samples: 0} = Timesync.show(sync, @start)
  end

  test "the offset is that of the sample with the shortest round trip" do
    offset = 60 * @second - @start
    # The answers are slow, except one.
    sync = run(0..100, offset, &if(&1 == 23, do: {500, 500}, else: {1_000, 41_000}))
    assert {^offset, error} = Timesync.offset(sync, now(25))
    assert error in 500..1_000
    assert %{offset_us: ^offset, rtt_us: 1_000, boot_at: boot_at} = Timesync.show(sync, now(25))
    assert boot_at == @start - 60 * @second
  end

  test "our own clock is set: the measured offset changes by the step" do
    offset = 60 * @second - @start
    sync = run(0..25, offset, fn _ -> {500, 500} end)

    for step <- [-3_600 * @second, 3_600 * @second] do
      shifted = Timesync.shifted(sync, step)
      at = now(25) + step
      assert {Timesync.offset(sync, now(25)), step} == {back(Timesync.offset(shifted, at), step), step}
      # By our clock the vehicle was started at another time, as long ago as before.
      assert at - Timesync.show(shifted, at).boot_at == now(25) - Timesync.show(sync, now(25)).boot_at

      # Answers to earlier requests are ignored, and the next request comes at the same time as without the step.
      assert shifted.pending == %{} and shifted.next - at == sync.next - now(25)
    end
  end

  defp back({offset, error}, step), do: {offset + step, error}

  test "asks three times at first, then once per period, and less often without an answer" do
    times = fn seconds, fun ->
      {sent, _sync} =
        Enum.flat_map_reduce(seconds, Timesync.new(10 * @second), fn second, sync ->
          {sync, requests} = Timesync.expire(sync, now(second))
          requests = for {nil, %M.Timesync{} = request} <- requests, do: request
          {Enum.map(requests, fn _ -> second end), Enum.reduce(requests, sync, fun)}
        end)

      sent
    end

    answered = times.(0..100, &reply(&2, %M.Timesync{tc1: 5, ts1: &1.ts1}, div(&1.ts1, 1000)))
    assert [1, 2, 3, 13, 23 | _] = answered
    silent = times.(0..600, fn _request, sync -> sync end)
    assert [1, 2, 3, 13, 23, 33, 93, 153 | _] = silent
    assert Timesync.expire(Timesync.new(0), @start) == {Timesync.new(0), []}
  end

  test "X5: an answer that is not ours changes nothing" do
    sync = run(0..5, 1_000, fn _ -> {10, 10} end)
    {sync, _} = Timesync.expire(sync, now(13))
    foreign = reply(sync, %M.Timesync{tc1: 999, ts1: 12_345}, now(13))
    assert foreign.samples == sync.samples
    assert Timesync.show(foreign, now(13)).foreign == 1
    # Nor does a second copy of our answer by a second link.
    {sync, [{nil, %{ts1: ts1}}]} = Timesync.expire(sync, now(23))
    once = reply(sync, %M.Timesync{tc1: 5, ts1: ts1}, now(23) + 10)
    twice = reply(once, %M.Timesync{tc1: 5, ts1: ts1}, now(23) + 5_000)
    assert twice.samples == once.samples
    refute Timesync.to?(%M.Timesync{target_system: 255, target_component: 190}, {245, 191})
    assert Timesync.to?(%M.Timesync{target_system: 0}, {245, 191})
  end

  test "R5: to everyone, to our system, to us; and nothing else" do
    own = {245, 191}

    to? = fn system, component ->
      Timesync.to?(%M.Timesync{target_system: system, target_component: component}, own)
    end

    assert to?.(0, 0) and to?.(245, 0) and to?.(245, 191)
    refute to?.(245, 190) or to?.(1, 191) or to?.(1, 0) or to?.(0, 190)
  end

  test "an answer that took too long does not count" do
    sync = run(0..5, 0, fn _ -> {1, 11 * @second} end)
    assert sync.samples == []
  end

  test "one odd answer is ignored; two in a row mean that the clock was set" do
    sync = run(0..30, 0, fn _ -> {100, 100} end)
    one = run(sync, 31..40, 5 * @second, fn _ -> {100, 100} end)
    assert {0, _} = Timesync.offset(one, now(40))
    two = run(one, 41..50, 5 * @second, fn _ -> {100, 100} end)
    assert {5_000_000, _} = Timesync.offset(two, now(50))
  end

  describe "a vehicle with several links" do
    test "is asked by each; a link's round trip is that of its own copy, the clock's sample the first copy" do
      {sync, []} = Timesync.expire(Timesync.new(10 * @second), @start, ["a", "b"])
      {sync, requests} = Timesync.expire(sync, now(1), ["a", "b"])
      assert [{"a", %M.Timesync{ts1: of_a}}, {"b", %M.Timesync{ts1: of_b}}] = requests
      assert of_a != of_b
      answer = &%M.Timesync{tc1: now(1) * 1000, ts1: &1}

      # The answer to the request by the slow link comes first by the fast one, as when a vehicle answers on all links.
      {sync, nil} = Timesync.reply(sync, answer.(of_a), now(1) + 200_000, "b")
      assert [{_at, 200_000, _offset}] = sync.samples
      {sync, {"a", 400_000}} = Timesync.reply(sync, answer.(of_a), now(1) + 400_000, "a")
      assert length(sync.samples) == 1
      {sync, {"b", 30_000}} = Timesync.reply(sync, answer.(of_b), now(1) + 30_000, "b")
      assert length(sync.samples) == 2
      # A further copy is not ours.
      assert {%{foreign: 1}, nil} = Timesync.reply(sync, answer.(of_b), now(1) + 50_000, "a")
    end

    test "with one link the round trip is that link's" do
      {sync, []} = Timesync.expire(Timesync.new(@second), @start, ["a"])
      {sync, [{nil, %{ts1: ts1}}]} = Timesync.expire(sync, now(1), ["a"])

      assert {_sync, {"a", 70_000}} =
               Timesync.reply(sync, %M.Timesync{tc1: 1, ts1: ts1}, now(1) + 70_000, "a")
    end

    test "a vehicle that does not answer TIMESYNC is sent PING, which gives a round trip and no clock" do
      sync =
        Enum.reduce(0..30, Timesync.new(10 * @second), fn second, sync ->
          {sync, requests} = Timesync.expire(sync, now(second), ["a", "b"])

          for({link, %M.Ping{} = ping} <- requests, do: {link, ping})
          |> Enum.reduce(sync, fn {link, %{target_system: 0, target_component: 0} = ping}, sync ->
            answer = %{ping | target_system: 245, target_component: 191}
            {sync, {^link, 5_000}} = Timesync.reply(sync, answer, now(second) + 5_000, link)
            sync
          end)
        end)

      assert sync.unanswered == 5 and sync.unpinged == 0 and sync.samples == []
      # It answers, so requests do not become rare.
      {sync, _requests} = Timesync.expire(sync, now(33), ["a", "b"])
      assert sync.next == now(43)
      assert map_size(sync.pending) <= 32
    end

    test "at most eight links are asked, and pending requests are bounded" do
      links = Enum.map(1..20, &"radio-#{&1}")

      sync =
        Enum.reduce(0..300, Timesync.new(@second), fn second, sync ->
          {sync, requests} = Timesync.expire(sync, now(second), links)
          assert length(requests) <= 16
          sync
        end)

      assert map_size(sync.pending) == 32
    end
  end

  test "after a reboot measuring begins again" do
    sync = run(0..30, 0, fn _ -> {100, 100} end) |> Timesync.restarted()
    assert Timesync.offset(sync, now(31)) == nil
    assert {7, _} = sync |> run(31..35, 7, fn _ -> {100, 100} end) |> Timesync.offset(now(35))
  end

  test "X5: requests are answered, answers and messages to others are not" do
    assert %M.Timesync{tc1: 5_000, ts1: 77, target_system: 1, target_component: 1} =
             Timesync.answer(%M.Timesync{tc1: 0, ts1: 77}, {1, 1}, {245, 191}, 5)

    refute Timesync.answer(%M.Timesync{tc1: 9, ts1: 77}, {1, 1}, {245, 191}, 5)
    refute Timesync.answer(%M.Timesync{tc1: 0, ts1: 7, target_system: 255}, {1, 1}, {245, 191}, 5)
    ping = %M.Ping{time_usec: 9, seq: 4}

    assert %M.Ping{time_usec: 9, seq: 4, target_system: 1, target_component: 1} =
             Timesync.answer(ping, {1, 1}, {245, 191}, 5)

    refute Timesync.answer(%{ping | target_system: 245, target_component: 191}, {1, 1}, {245, 191}, 5)
  end

  test "a flood of requests gets ten answers a second" do
    {answers, _sync} =
      Enum.map_reduce(0..999, Timesync.new(0), fn ms, sync -> Timesync.answer?(sync, @start + ms * 1000) end)

    assert Enum.count(answers, & &1) == 10
  end

  test "the error is never too small, whatever the delays" do
    delays = {:proper_types.range(0, 400_000), :proper_types.range(0, 400_000)}

    prop =
      :proper.forall(
        {:proper_types.range(-1_000_000_000, 1_000_000_000),
         :proper_types.non_empty(:proper_types.list(delays))},
        fn {offset, delays} ->
          delays = List.to_tuple(delays)
          sync = run(0..60, offset, &elem(delays, rem(&1, tuple_size(delays))))
          {estimate, error} = Timesync.offset(sync, now(61))
          abs(estimate - offset) <= error + 1
        end
      )

    assert :proper.quickcheck(prop, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
