defmodule Circuits.UART.CoreTest do
  use ExUnit.Case, async: true

  alias Circuits.UART.{Core, State, Wire}
  alias Circuits.UART.Test.FakeProgram

  # A run: the core, the port program that it talks to, the timers that run, and who was answered what.
  defstruct core: %State{},
            fake: %FakeProgram{},
            now: 0,
            timers: MapSet.new(),
            calls: 0,
            replies: %{},
            sent: []

  test "whatever happens in whatever order, each call is answered once and nothing is left over" do
    property =
      :proper.forall(:proper_types.list(any_event()), fn events ->
        run = events |> Enum.reduce(%__MODULE__{}, &step/2) |> settle()

        Enum.all?(1..run.calls//1, &match?(%{^&1 => [_one]}, run.replies)) and
          map_size(run.replies) == run.calls and run.core.pending == %{} and MapSet.size(run.timers) == 0 and
          :queue.is_empty(run.core.readers) and :queue.is_empty(run.core.senders) and
          run.core.phase == :closed
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 1_000, max_size: 120]) == true,
           inspect(:proper.counterexample())
  end

  test "however modes, reads and bytes mix, every byte arrives, in order" do
    events =
      :proper_types.oneof([
        {:call, {:read, 0}},
        {:call, {:read, 50}},
        {:call, {:configure, [active: true]}},
        {:call, {:configure, [active: false]}},
        {:line, {:bytes, "a"}},
        {:line, {:bytes, "bc"}},
        {:line, {:bytes, "def"}},
        {:line, :read_timeout},
        :deliver,
        :deliver,
        {:timer, :proper_types.integer(0, 3)},
        {:later, 20}
      ])

    property =
      :proper.forall(:proper_types.list(events), fn events ->
        run = Enum.reduce([{:call, {:open, "/dev/x", []}}, :deliver], %__MODULE__{}, &step/2)
        run = events |> Enum.reduce(run, &step/2) |> deliver_all()
        # Ends in active mode, so that what nobody read comes too; the order is that of `sent`.
        run = deliver_all(step({:call, {:configure, [active: true]}}, run))

        produced = for {:line, {:bytes, bytes}} <- events, into: "", do: bytes
        run.sent |> Enum.reverse() |> Enum.join() == produced <> ""
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 1_000, max_size: 120]) == true,
           inspect(:proper.counterexample())
  end

  test "an answer that comes after its request was given up is not taken for another one's" do
    run = Enum.reduce([{:call, {:open, "/dev/x", [active: false]}}, :deliver], %__MODULE__{}, &step/2)
    run = step({:call, {:read, 50}}, run)
    late = run.fake.reading
    run = deliver_all(step({:call, {:open, "/dev/x", [active: false]}}, run))
    run = step({:call, {:read, 50}}, run)

    {core, actions} = Core.handle(run.core, {:program, {:ok, late, "late"}}, run.now)
    assert actions == []
    assert core.reading == run.core.reading
    refute core.reading == late
  end

  test "a request that is not answered ends the program, and all callers get an error" do
    run = Enum.reduce([{:call, {:open, "/dev/x", []}}, :deliver], %__MODULE__{}, &step/2)
    run = Enum.reduce([{:call, {:flush, 100}}, {:call, {:write, "x", 10}}], run, &step/2)
    [first | _] = run.core.pending |> Map.keys() |> Enum.sort()

    {core, actions} = Core.handle(run.core, {:timer, {:request, first}}, run.now)
    assert {:kill_program, "/dev/x"} in actions
    assert [{:error, :etimedout}, {:error, :etimedout}] = for({:reply, _from, result} <- actions, do: result)
    assert [{:error, :etimedout}] = for({:send, _pid, {:name, "/dev/x"}, data} <- actions, do: data)
    assert %{phase: :closed, pending: pending} = core
    assert pending == %{}
  end

  defp any_event do
    :proper_types.oneof([
      {:call, {:open, "/dev/x", []}},
      {:call, {:open, "/dev/x", [active: false]}},
      {:call, {:open, "/dev/bad", []}},
      {:call, {:open, "/dev/x", [speed: 0]}},
      {:call, {:configure, [active: true]}},
      {:call, {:configure, [active: false, speed: 57_600]}},
      {:call, {:configure, [speed: :wrong]}},
      {:call, :configuration},
      {:call, {:read, 0}},
      {:call, {:read, 50}},
      {:call, {:write, "short", 50}},
      {:call, {:write, :binary.copy("long", 5_000), 50}},
      {:call, {:drain, 100}},
      {:call, {:flush, 100}},
      {:call, {:controlling_process, self()}},
      {:line, {:bytes, "ab"}},
      {:line, {:bytes, "c"}},
      {:line, :read_timeout},
      {:line, :sent},
      {:line, :sent},
      {:line, :send_timeout},
      {:line, :hang_up},
      :deliver,
      :deliver,
      :deliver,
      {:timer, :proper_types.integer(0, 5)},
      {:later, 20},
      :program_down
    ])
  end

  defp step({:call, request}, run) do
    from = {self(), run.calls + 1}
    event(%{run | calls: run.calls + 1}, {:call, from, request})
  end

  defp step({:line, what}, run), do: %{run | fake: FakeProgram.line(run.fake, what)}
  defp step({:later, ms}, run), do: %{run | now: run.now + ms}
  defp step(:program_down, run), do: event(%{run | fake: %FakeProgram{}}, {:program_down, :epipe})

  defp step(:deliver, run) do
    case FakeProgram.take(run.fake) do
      :empty -> run
      {packet, fake} -> event(%{run | fake: fake}, {:program, Wire.decode(packet)})
    end
  end

  # One of those that run, but not that of a request: the program is slow here, never stuck.
  defp step({:timer, n}, run) do
    case run.timers |> Enum.reject(&match?({:request, _id}, &1)) |> Enum.at(n) do
      nil -> run
      timer -> event(%{run | timers: MapSet.delete(run.timers, timer)}, {:timer, timer})
    end
  end

  defp event(run, event) do
    {core, actions} = Core.handle(run.core, event, run.now)
    Enum.reduce(actions, %{run | core: core}, &perform/2)
  end

  defp perform({:reply, {_pid, call}, result}, run) do
    run = %{run | replies: Map.update(run.replies, call, [result], &[result | &1])}

    if match?({:ok, data} when is_binary(data) and data != "", result),
      do: received(run, elem(result, 1)),
      else: run
  end

  defp perform({:send, _pid, _id, data}, run) when is_binary(data), do: received(run, data)
  defp perform({:send, _pid, _id, _data}, run), do: run
  defp perform({:command, packet}, run), do: %{run | fake: FakeProgram.packet(run.fake, packet)}
  defp perform({:start_timer, name, ms}, run) when ms >= 0, do: %{run | timers: MapSet.put(run.timers, name)}
  defp perform({:cancel_timer, name}, run), do: %{run | timers: MapSet.delete(run.timers, name)}

  defp received(run, data), do: %{run | sent: [data | run.sent]}

  defp deliver_all(run) do
    if :queue.is_empty(run.fake.out), do: run, else: deliver_all(step(:deliver, run))
  end

  # The end of everything: the program goes, and the timers that run fire.
  defp settle(run) do
    run = step(:program_down, run)
    Enum.reduce(run.timers, run, &event(%{&2 | timers: MapSet.delete(&2.timers, &1)}, {:timer, &1}))
  end
end
