defmodule Aerie.LossyLink do
  @moduledoc """
  Runs a transfer machine against a model of a vehicle over a link that loses, repeats and delays, without a clock or a socket:
  the same seed gives the same run.
  """

  @source {1, 1}
  @max_steps 200_000

  @typedoc """
    * `:seed`; `:loss`, `:duplicate` - shares, each way; `:delay`, `:jitter` - microseconds, each way
    * `:script` - `[{at, fun}]`: at that time the vehicle becomes `fun.(vehicle)`, or `{:reboot, vehicle}`
    * `:until` - at that time the run ends, whatever the machine does
  """
  @type option :: {atom(), term()}

  @doc """
  Starts the machine and runs it to its end. `answer.(vehicle, message, now)` gives the vehicle and what it sends:
  `[{after_us, message}]`. The answer has `:result` (nil without an end), `:machine`, `:vehicle`, `:at`, `:sent`,
  `:progress`, `:data`.
  """
  @spec run(module(), struct(), term(), (term(), struct(), integer() -> {term(), list()}), [option()]) ::
          map()
  def run(module, machine, vehicle, answer, options \\ []) do
    state = %{
      module: module,
      machine: machine,
      vehicle: vehicle,
      answer: answer,
      options:
        Map.new(
          Keyword.merge([loss: 0.0, duplicate: 0.0, delay: 20_000, jitter: 0, until: 600_000_000], options)
        ),
      rand: :rand.seed_s(:exsss, options[:seed] || 1),
      queue: :gb_sets.new(),
      n: 0,
      now: 0,
      sent: [],
      progress: [],
      data: [],
      result: nil,
      steps: 0
    }

    state =
      Enum.reduce(Keyword.get(options, :script, []), state, fn {at, fun}, s ->
        enqueue(s, at, {:script, fun})
      end)

    state |> step({:start, 0}) |> loop()
  end

  @doc "`answer` for `run/5` of a vehicle that stands still until `us`, and loses what comes before."
  @spec still(non_neg_integer(), answer) :: answer
        when answer: (term(), struct(), integer() -> {term(), list()})
  def still(us, answer) do
    fn vehicle, message, now -> if now < us, do: {vehicle, []}, else: answer.(vehicle, message, now) end
  end

  defp loop(%{result: result} = s) when result != nil, do: finish(s)
  defp loop(%{steps: @max_steps}), do: raise("the machine does not come to an end")

  defp loop(s) do
    wake = s.module.wake_at(s.machine)
    next = if :gb_sets.is_empty(s.queue), do: nil, else: :gb_sets.smallest(s.queue)
    s = %{s | steps: s.steps + 1}

    cond do
      next != nil and (wake == nil or elem(next, 0) <= wake) -> s |> take(next) |> ended() |> loop()
      wake != nil -> %{s | now: max(s.now, wake)} |> tick() |> ended() |> loop()
      true -> finish(s)
    end
  end

  defp ended(%{now: now, options: %{until: until}} = s) when now > until,
    do: %{s | result: s.result || :until}

  defp ended(s), do: s

  defp tick(s), do: step(s, {:tick, s.now})

  defp take(s, {at, _n, what} = next) do
    s = %{s | now: max(s.now, at), queue: :gb_sets.delete(next, s.queue)}

    case what do
      {:to_vehicle, message} -> vehicle(s, message)
      {:to_us, message} -> step(s, {:message, message, @source, s.now})
      {:from_vehicle, message} -> transmit(s, :to_us, message, s.now)
      {:script, fun} -> script(s, fun.(s.vehicle))
    end
  end

  defp script(s, {:reboot, vehicle}), do: step(%{s | vehicle: vehicle}, {:rebooted, s.now})
  defp script(s, {:say, event}), do: step(s, event)
  defp script(s, vehicle), do: %{s | vehicle: vehicle}

  defp vehicle(s, message) do
    {vehicle, said} = s.answer.(s.vehicle, message, s.now)

    Enum.reduce(said, %{s | vehicle: vehicle}, fn {later, m}, s ->
      enqueue(s, s.now + later, {:from_vehicle, m})
    end)
  end

  defp step(s, event) do
    {machine, actions} = s.module.handle(s.machine, event)
    Enum.reduce(actions, %{s | machine: machine}, &act/2)
  end

  defp act({:send, messages}, s) do
    s = %{s | sent: Enum.reverse(Enum.map(messages, &{s.now, &1})) ++ s.sent}
    Enum.reduce(messages, s, &transmit(&2, :to_vehicle, &1, &2.now))
  end

  defp act({:progress, done, total}, s), do: %{s | progress: [{done, total} | s.progress]}
  defp act({:data, offset, bytes}, s), do: %{s | data: [{offset, bytes} | s.data]}
  defp act({:done, _result}, %{result: result}) when result != nil, do: raise("two ends")
  defp act({:done, result}, s), do: %{s | result: result}

  defp transmit(s, direction, message, now) do
    {lost, s} = chance(s, s.options.loss)
    {twice, s} = chance(s, s.options.duplicate)
    copies = if lost, do: 0, else: if(twice, do: 2, else: 1)

    Enum.reduce(1..copies//1, s, fn _copy, s ->
      {share, rand} = :rand.uniform_s(s.rand)

      enqueue(
        %{s | rand: rand},
        now + s.options.delay + round(share * s.options.jitter),
        {direction, message}
      )
    end)
  end

  defp chance(s, share) do
    {number, rand} = :rand.uniform_s(s.rand)
    {number < share, %{s | rand: rand}}
  end

  defp enqueue(s, at, what), do: %{s | n: s.n + 1, queue: :gb_sets.add({at, s.n, what}, s.queue)}

  defp finish(s) do
    # What was sent at the end still arrives.
    s =
      for {_at, _n, {:to_vehicle, message}} <- :gb_sets.to_list(s.queue),
          reduce: s,
          do: (s -> vehicle(s, message))

    result = if s.result == :until, do: nil, else: s.result

    %{
      result: result,
      machine: s.machine,
      vehicle: s.vehicle,
      at: s.now,
      sent: Enum.reverse(s.sent),
      progress: Enum.reverse(s.progress),
      data: s.data
    }
  end

  @doc "What `{:data, offset, bytes}` actions gave; raises if they overlap or leave a gap."
  @spec bytes(map(), non_neg_integer()) :: binary()
  def bytes(run, from \\ 0) do
    {parts, _end} =
      run.data
      |> Enum.sort()
      |> Enum.map_reduce(from, fn {offset, bytes}, at ->
        if offset != at, do: raise("bytes #{at} to #{offset} are missing or double")
        {bytes, at + byte_size(bytes)}
      end)

    IO.iodata_to_binary(parts)
  end
end
