defmodule Msp.Session.Commands do
  @moduledoc """
  Commands that come as MAVLink and are carried out over MSP, one after the other, and their COMMAND_ACK. The acknowledgement says what the
  flight controller said: a refusal is FAILED. Without an answer there is none, because nobody knows.

  Betaflight restarts while it is armed if it is asked to, and writes its settings whenever; so what `MavCodec.Msp.Message` says is not for
  armed vehicles is refused here.
  """

  @behaviour Msp.Session.Tasks

  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Messages
  alias Msp.{Firmware, Polls, Session}
  alias Msp.Session.Commands.Places
  alias Msp.Session.{Missions, Motors, Output, Params, Requests, Sticks, Tasks}
  alias Msp.Session.Tasks.Armed

  @command_long M.CommandLong.id()
  @command_int M.CommandInt.id()
  @commands Map.new(
              [
                :REQUEST_MESSAGE,
                :SET_MESSAGE_INTERVAL,
                :GET_MESSAGE_INTERVAL,
                :PREFLIGHT_REBOOT_SHUTDOWN,
                :PREFLIGHT_CALIBRATION,
                :PREFLIGHT_STORAGE,
                :COMPONENT_ARM_DISARM,
                :DO_SET_MODE,
                :DO_MOTOR_TEST
              ],
              &{MavCmd.value(:"MAV_CMD_#{&1}"), &1}
            )
  # Writing the EEPROM takes up to two seconds on hardware; configurators wait for five.
  @slow_us 5_000_000
  @warning 4
  @notice 5
  @known_us 3_000_000

  @doc "A frame of a client."
  @spec frame(Session.t(), MavCodec.Frame.t(), integer) :: Session.t()
  def frame(%{phase: :up, system: system} = session, %{id: id} = frame, now)
      when id in [@command_long, @command_int] do
    case MavCodec.decode(frame) do
      {:ok, %{target_system: ^system, target_component: component} = command} when component in [0, 1] ->
        command_of(session, command, frame, now)

      _for_another ->
        session
    end
  end

  def frame(%{phase: :up} = session, %{id: id} = frame, now) do
    from = {frame.system, frame.component}
    part = Enum.find([Params, Missions, Sticks], & &1.mine?(id))

    with true <- part != nil, {:ok, message} <- MavCodec.decode(frame) do
      part.message(session, message, from, now)
    else
      _other -> session
    end
  end

  def frame(session, _frame, _now), do: session

  defp command_of(session, command, frame, now) do
    from = {frame.system, frame.component}

    cond do
      Places.mine?(command) -> Places.command(session, command, from)
      is_struct(command, M.CommandInt) -> Output.acknowledge(session, command.command, from, :UNSUPPORTED)
      true -> command(session, Map.get(@commands, command.command), command, from, now)
    end
  end

  defp command(session, :REQUEST_MESSAGE, command, from, _now) do
    with id when id != nil <- whole(command.param1),
         {:ok, messages} <- Requests.message(session, id, whole(command.param2) || 0) do
      session |> Output.acknowledge(command.command, from, :ACCEPTED) |> Output.emit(messages)
    else
      _none -> Output.acknowledge(session, command.command, from, :UNSUPPORTED)
    end
  end

  defp command(session, :SET_MESSAGE_INTERVAL, command, from, _now) do
    with id when id != nil <- whole(command.param1),
         us when us != nil <- whole(command.param2),
         {:ok, polls} <- Polls.interval(session.polls, id, us) do
      Output.acknowledge(%{session | polls: polls}, command.command, from, :ACCEPTED)
    else
      # UNSUPPORTED would say that it knows no intervals.
      _none -> Output.acknowledge(session, command.command, from, :DENIED)
    end
  end

  defp command(session, :GET_MESSAGE_INTERVAL, command, from, _now) do
    case whole(command.param1) do
      nil ->
        Output.acknowledge(session, command.command, from, :DENIED)

      id ->
        session
        |> Output.acknowledge(command.command, from, :ACCEPTED)
        |> Output.emit(Requests.interval(session, id))
    end
  end

  # Until the gateway knows which firmware it is, its policy does not ask for what that needs.
  defp command(%{up_at: at} = session, name, %{param1: p} = command, from, now)
       when name in [:COMPONENT_ARM_DISARM, :DO_SET_MODE, :DO_MOTOR_TEST] and now - at < @known_us and
              not (name == :COMPONENT_ARM_DISARM and p == 0.0),
       do:
         session
         |> Output.text(
           @warning,
           "Not done: the vehicle was just found, try again in #{div(@known_us, 1_000_000)} s"
         )
         |> Output.acknowledge(command.command, from, :TEMPORARILY_REJECTED)

  defp command(session, name, command, from, now) when name in [:COMPONENT_ARM_DISARM, :DO_SET_MODE] do
    case Sticks.wish(name, command, session.identity.firmware) do
      nil -> Output.acknowledge(session, command.command, from, :UNSUPPORTED)
      want -> Sticks.command(session, want, command.command, from, now)
    end
  end

  defp command(session, :DO_MOTOR_TEST, command, from, _now), do: Motors.test(session, command, from)

  defp command(session, name, command, from, _now) do
    case message(Firmware.of(session.identity.firmware), name, command) do
      nil -> Output.acknowledge(session, command.command, from, :UNSUPPORTED)
      message -> queue(session, message, command.command, from)
    end
  end

  defp message(_firmware, :PREFLIGHT_REBOOT_SHUTDOWN, %{param1: 1.0}), do: "REBOOT"
  defp message(_firmware, :PREFLIGHT_CALIBRATION, %{param2: 1.0}), do: "MAG_CALIBRATION"
  defp message(_firmware, :PREFLIGHT_CALIBRATION, %{param5: p}) when p in [1.0, 4.0], do: "ACC_CALIBRATION"

  defp message(%{missions?: true}, :PREFLIGHT_STORAGE, %{param1: p, param2: 1.0}) when p != 1.0,
    do: "WP_MISSION_SAVE"

  defp message(_firmware, :PREFLIGHT_STORAGE, %{param1: 1.0, param2: p}) when p != 1.0, do: "EEPROM_WRITE"
  defp message(_firmware, _name, _command), do: nil

  # What is repeated while it is being done is not done twice.
  defp queue(session, name, command, from) do
    {:ok, message} = Messages.fetch(session.identity.firmware, name)

    cond do
      Tasks.any?(session, &(&1[:command] == command and match?({^name, _, _}, &1.ask))) ->
        Output.acknowledge(session, command, from, :IN_PROGRESS)

      not Tasks.room?(session) ->
        Output.acknowledge(session, command, from, :TEMPORARILY_REJECTED)

      message.armed != :yes and Armed.early(session) != nil ->
        denied(session, name, command, from, Armed.early(session))

      true ->
        Tasks.add(session, %{
          kind: __MODULE__,
          command: command,
          from: from,
          ask: {name, values(name), @slow_us}
        })
    end
  end

  defp denied(session, name, command, from, why),
    do:
      session
      |> Output.acknowledge(command, from, :DENIED)
      |> Output.text(@notice, "#{name} refused: #{why}")

  # Its argument means nothing.
  defp values("WP_MISSION_SAVE"), do: %{mission: 0}
  defp values(_name), do: %{}

  @impl Tasks
  def answer(session, %{command: command, from: from, ask: {name, _values, _patience}} = task, answer, now) do
    session = Tasks.done(session, task)

    case answer do
      {:ok, _values} -> session |> Output.acknowledge(command, from, :ACCEPTED) |> done(name, now)
      :refused -> Output.acknowledge(session, command, from, :FAILED)
      {:denied, why} -> denied(session, name, command, from, why)
      # This version does not have it.
      {:unfit, _why} -> Output.acknowledge(session, command, from, :UNSUPPORTED)
      :timeout -> session
    end
  end

  # Its clock begins again, and its boxes may be others.
  defp done(session, "REBOOT", _now), do: %{session | restarted: true}
  defp done(session, "EEPROM_WRITE", _now), do: Params.stored(session)
  defp done(session, _name, _now), do: session

  # A number that MAVLink puts into a float.
  defp whole(number) when is_float(number) and number >= -1.0 and number <= 16_777_216.0, do: round(number)
  defp whole(_other), do: nil
end
