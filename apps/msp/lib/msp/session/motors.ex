defmodule Msp.Session.Motors do
  @longest_us 3_000_000
  @again_us 200_000

  @moduledoc """
  Motors that turn without the vehicle being armed: DO_MOTOR_TEST, for #{div(@longest_us, 1_000_000)} s at most, one motor at a time.

  Firmware lets a motor run until it is told otherwise, also when nobody is there any more. So all are stopped when the time is over, when the
  line is closed in order, and when a vehicle is found whose motors turn although it is not armed: somebody left them
  on. Stopping is written
  every #{div(@again_us, 1000)} ms until the vehicle says that they stand still; while it is armed its motors are its
  own, and stopping goes on afterwards. Vehicles whose
  motors turn both ways are left alone: the value that stops them is another one.

  A motor stands still at the value that stops it and at no other: with DSHOT each value above turns it. That is 1000,
  and with iNav its `min_command`.
  """
  @behaviour Msp.Session.Tasks

  alias MavCodec.Msp.Frame
  alias Msp.{Firmware, Identity, Session}
  alias Msp.Session.{Output, Sticks, Tasks}
  alias Msp.Session.Tasks.Armed

  @stop 1000
  defstruct [:turning, :one_way, still: @stop]

  @typedoc """
  - `turning`: when those that turn are stopped, and how often they were told to; nil while none turns
  - `one_way`: whether they turn one way only, so that `still` in µs stops them; nil until the vehicle has said so
  """
  @type t :: %__MODULE__{
          turning: %{due: integer, stops: non_neg_integer} | nil,
          one_way: boolean | nil,
          still: non_neg_integer
        }

  @motors 8
  @both_ways 12
  @percent 0
  @warning 4
  @critical 2
  # After the first time.
  @tries 2
  @most_stops 50
  # Turning is asked once, so its reply gets longer than others before the motor is stopped again.
  @run_us 1_000_000

  @doc "DO_MOTOR_TEST."
  @spec test(Session.t(), struct, {byte, byte}) :: Session.t()
  def test(session, %{command: command, param1: motor, param2: kind, param3: percent, param4: seconds}, from) do
    us = if is_number(seconds), do: round(min(max(seconds, 0), 1.0e6) * 1_000_000)

    cond do
      not (is_number(motor) and is_number(percent) and kind == @percent and us != nil) or percent < 0 or
          percent > 100 ->
        Output.acknowledge(session, command, from, :DENIED)

      Armed.early(session) != nil or Sticks.steered?(session) ->
        refuse(session, command, from, "it is armed, or about to be")

      us > @longest_us ->
        refuse(session, command, from, "a motor runs for #{div(@longest_us, 1_000_000)} s at most")

      session.motors.turning != nil or Tasks.any?(session, &(&1.kind == __MODULE__)) ->
        Output.acknowledge(session, command, from, :TEMPORARILY_REJECTED)

      true ->
        look(session, %{
          what: :test,
          command: command,
          from: from,
          motor: round(motor),
          us: us,
          value: @stop + round(percent * 10)
        })
    end
  end

  @doc "A vehicle was found: whether somebody left its motors on. Asked after its state, which says whether it is armed."
  @spec found(Session.t()) :: Session.t()
  def found(session), do: look(session, %{what: :found, command: nil, from: nil, bulk: true})

  defp look(session, task) do
    features = Firmware.of(session.identity.firmware).features
    Tasks.add(session, Map.merge(task, %{kind: __MODULE__, tries: 0, ask: {features, %{}}}))
  end

  @impl Tasks
  def answer(session, %{tries: tries, what: what} = task, :timeout, _now)
      when tries < @tries and what != :run,
      do: Tasks.ask_next(session, task, %{tries: tries + 1})

  def answer(session, %{ask: {"MOTOR", _}} = task, {:ok, %{entries: entries}}, now),
    do: turning(session, task, Enum.map(entries, & &1.motor), now)

  def answer(session, %{ask: {"SET_MOTOR", _, _}} = task, {:ok, _acknowledged}, _now),
    do: session |> Tasks.done(task) |> Output.acknowledge(task.command, task.from, :ACCEPTED)

  def answer(session, %{ask: {_feature, _}} = task, {:ok, %{features: features}}, _now) do
    session = put_in(session.motors.one_way, Bitwise.band(features, Bitwise.bsl(1, @both_ways)) == 0)

    still = Firmware.of(session.identity.firmware).still

    cond do
      not session.motors.one_way -> ended(session, task, "its motors turn both ways")
      still != nil -> Tasks.ask_next(session, task, %{tries: 0, ask: {still, %{}}})
      true -> motors(put_in(session.motors.still, @stop), task)
    end
  end

  def answer(session, %{ask: {"MSP2_INAV_MISC", _}} = task, answer, _now) do
    still = with {:ok, %{min_command: us}} <- answer, do: us, else: (_unknown -> @stop)
    motors(put_in(session.motors.still, still), task)
  end

  def answer(session, %{what: :run} = task, {:denied, why}, _now),
    do: put_in(session.motors.turning, nil) |> Tasks.done(task) |> refuse(task.command, task.from, why)

  def answer(session, %{what: :run} = task, _none, _now),
    do: session |> ended(task, "whether the motor turned is not known") |> stop()

  def answer(session, task, _none, _now), do: ended(session, task, "it does not say how its motors are")

  defp motors(session, task), do: Tasks.ask_next(session, task, %{tries: 0, ask: {"MOTOR", %{}}})

  defp ended(session, %{what: :test} = task, why),
    do: session |> Tasks.done(task) |> refuse(task.command, task.from, why)

  defp ended(session, %{what: :run} = task, why),
    do:
      session
      |> Tasks.done(task)
      |> Output.text(@warning, "Motor test: #{why}")
      |> Output.acknowledge(task.command, task.from, :FAILED)

  # A vehicle that does not say stays as it is.
  defp ended(session, task, _why), do: Tasks.done(session, task)

  defp turning(session, %{what: :test} = task, values, now) do
    cond do
      turn?(session, values) ->
        session
        |> Tasks.done(task)
        |> left_on(now)
        |> refuse(task.command, task.from, "motors were on: they are stopped")

      task.motor not in 1..@motors or Enum.at(values, task.motor - 1, 0) == 0 ->
        ended(session, task, "it has no motor #{task.motor}")

      true ->
        entries =
          for n <- 1..@motors, do: %{motor: if(n == task.motor, do: task.value, else: session.motors.still)}

        Tasks.ask_next(until(session, now + task.us), task, %{
          what: :run,
          ask: {"SET_MOTOR", %{entries: entries}, @run_us}
        })
    end
  end

  defp turning(session, %{what: :found} = task, values, now) do
    session = Tasks.done(session, task)

    if Armed.state(session) != :armed and turn?(session, values),
      do: left_on(session, now),
      else: session
  end

  defp turning(session, %{what: :stopping} = task, values, _now) do
    session = Tasks.done(session, task)
    if turn?(session, values), do: session, else: put_in(session.motors.turning, nil)
  end

  @doc "Whether one of these motors turns, by its value. 0 is a motor that is not there."
  @spec turn?(Session.t(), [non_neg_integer]) :: boolean
  def turn?(%{motors: %{still: still}}, values), do: Enum.any?(values, &(&1 not in [0, still]))

  defp left_on(session, now),
    do:
      Output.text(
        until(session, now),
        @critical,
        "Motors turned although it was not armed: somebody left them on, and they are stopped"
      )

  @doc "Stops them at once, before anything else."
  @spec stop(Session.t()) :: Session.t()
  def stop(%{motors: %{turning: nil}} = session), do: session
  def stop(session), do: put_in(session.motors.turning.due, 0)

  @doc "They turn, and are stopped then unless this is said again."
  @spec until(Session.t(), integer) :: Session.t()
  def until(session, at), do: put_in(session.motors.turning, %{due: at, stops: 0})

  @doc "When they are stopped, nil while none turns."
  @spec due_at(Session.t()) :: integer | nil
  def due_at(%{motors: %{turning: turning}}), do: turning && turning.due

  @doc "Another vehicle may be at the line, whose motors turn both ways."
  @spec forget(Session.t()) :: Session.t()
  def forget(session), do: put_in(session.motors.one_way, nil)

  @doc "Stops them when their time is over, until they stand still."
  @spec due(Session.t(), integer) :: {Session.t(), [{:write, binary}]}
  def due(%{motors: %{turning: %{due: due, stops: stops}}, phase: :up} = session, now) when now >= due do
    cond do
      # Its motors are its own now. Those that were set turn again once it is disarmed.
      Armed.state(session) == :armed ->
        {until(session, now + @again_us), []}

      stops >= @most_stops ->
        {Output.text(
           put_in(session.motors.turning, nil),
           @critical,
           "Motors may still turn: the vehicle does not say that they stand still"
         ), []}

      true ->
        session = put_in(session.motors.turning, %{due: now + @again_us, stops: stops + 1})
        asked? = Tasks.any?(session, &match?(%{kind: __MODULE__, what: :stopping}, &1))

        session =
          if asked?,
            do: session,
            else:
              Tasks.add(session, %{
                kind: __MODULE__,
                what: :stopping,
                command: nil,
                from: nil,
                tries: @tries,
                ask: {"MOTOR", %{}}
              })

        {session, [{:write, stop_frame(session)}]}
    end
  end

  def due(session, _now), do: {session, []}

  @doc "What is written before the line is closed."
  @spec closing(Session.t()) :: [{:write, binary}]
  def closing(%{motors: %{turning: %{}}, phase: :up} = session), do: [{:write, stop_frame(session)}]
  def closing(_session), do: []

  defp stop_frame(session) do
    entries = List.duplicate(%{motor: session.motors.still}, @motors)
    {:ok, frame} = MavCodec.Msp.request(Identity.target(session.identity), "SET_MOTOR", %{entries: entries})
    IO.iodata_to_binary(Frame.encode(frame))
  end

  defp refuse(session, command, from, why),
    do: session |> Output.text(@warning, "Motor test: #{why}") |> Output.acknowledge(command, from, :DENIED)
end
