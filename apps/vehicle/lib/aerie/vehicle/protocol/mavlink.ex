defmodule Aerie.Vehicle.Protocol.Mavlink do
  @moduledoc """
  What both MAVLink firmwares share: steps as COMMAND_LONG, COMMAND_INT or a message, their encoding, and the reading of
  COMMAND_ACK.

  Forms:

    * `{:long, command, params}` - seven floats
    * `{:int, command, frame, params, {lat, lon}, z}` - four floats, degrees or nil, and a height or `:nan`
    * `{:message, struct}` - without its target

  Parameters that are not given are sent as MAVLink declares them: their default, or 0 (C9).
  """

  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Protocol.{Step, Vehicle}
  alias MavCodec.Enums.{MavCmd, MavResult}
  alias MavCodec.Messages, as: M

  # The value of x and y in COMMAND_INT for "not given" (C9).
  # The component id of nearly every autopilot.
  @autopilot 1
  @no_place 2_147_483_647
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @busy MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  @in_progress MavResult.value(:MAV_RESULT_IN_PROGRESS)
  @cancelled MavResult.value(:MAV_RESULT_CANCELLED)
  @long_only MavResult.value(:MAV_RESULT_COMMAND_LONG_ONLY)
  @int_only MavResult.value(:MAV_RESULT_COMMAND_INT_ONLY)
  @other_frame MavResult.value(:MAV_RESULT_COMMAND_UNSUPPORTED_MAV_FRAME)
  # It was not tried.
  @rejections for name <- [:DENIED, :UNSUPPORTED, :NOT_IN_CONTROL], do: MavResult.value(:"MAV_RESULT_#{name}")

  @type form ::
          {:long, non_neg_integer(), [number() | :nan]}
          | {:int, non_neg_integer(), non_neg_integer(), [number() | :nan], {float(), float()} | nil,
             number() | :nan}
          | {:message, struct()}

  @doc "A step that sends a command of MAV_CMD with seven floats, given by their numbers; the others are as MAVLink declares them."
  @spec long(command :: atom(), %{(1..7) => number() | :nan}, keyword()) :: Step.t()
  def long(name, params \\ %{}, options \\ []) do
    command = number(name)
    step({:command, command}, [{:long, command, params(command, params, 1..7)}], options)
  end

  @doc """
  A step that sends a command with a position as COMMAND_INT. `frames` are the possible frames with the height in each;
  the first is used unless the vehicle asks for another (result 9).
  """
  @spec int(
          command :: atom(),
          [{frame :: non_neg_integer(), z :: number() | :nan}, ...],
          {float(), float()} | nil,
          %{(1..4) => number() | :nan},
          keyword()
        ) :: Step.t()
  def int(name, frames, place, params \\ %{}, options \\ []) do
    command = number(name)
    params = params(command, params, 1..4)

    step(
      {:command, command},
      for({frame, z} <- frames, do: {:int, command, frame, params, place, z}),
      options
    )
  end

  @doc "A step that is a message other than a command; the vehicle does not acknowledge it."
  @spec message(struct(), keyword()) :: Step.t()
  def message(%module{} = message, options \\ []),
    do: step({:message, module}, [{:message, message}], [acked?: false] ++ options)

  defp step(key, forms, options) do
    # A camera and an autopilot may get the same command at the same time; its own number means the autopilot (C8).
    component = if options[:component] != @autopilot, do: options[:component]
    step = struct!(%Step{key: {component, key}, forms: forms}, options)

    case step.cancel do
      {:long, command, _params} -> %{step | cancel_key: {component, {:command, command}}}
      _other -> step
    end
  end

  defp number(name) do
    number = MavCmd.value(name)
    true = is_integer(number)
    number
  end

  defp params(command, given, indices) do
    declared = Map.new(MavCmd.params(command), &{&1.index, &1.default})
    Enum.map(indices, &(Map.get(given, &1) || declared[&1] || 0.0))
  end

  @doc "The message of a step."
  @spec encode(Step.t(), non_neg_integer(), Vehicle.t()) :: [struct()]
  def encode(%Step{forms: [form | _others]} = step, attempt, vehicle),
    do: [put(form, attempt, vehicle.system, step.component || vehicle.component)]

  @doc "The messages that cancel a step: its own, or COMMAND_CANCEL (C5); the reason if nothing does."
  @spec cancel(Step.t(), Vehicle.t()) :: [struct()] | {:error, String.t()}
  def cancel(%Step{cancel: {:never, reason}}, _vehicle), do: {:error, reason}

  def cancel(%Step{cancel: nil, acked?: true} = step, vehicle),
    do: encode_form({:message, %M.CommandCancel{command: command(step)}}, step, vehicle)

  def cancel(step, vehicle), do: encode_form(step.cancel, step, vehicle)

  @doc "The messages that end a stream."
  @spec release(Step.t(), Vehicle.t()) :: [struct()]
  def release(step, vehicle), do: encode_form(step.stream.release, step, vehicle)

  defp encode_form(nil, _step, _vehicle), do: []
  defp encode_form(form, step, vehicle), do: encode(%{step | forms: [form]}, 0, vehicle)

  defp put({:long, command, [p1, p2, p3, p4, p5, p6, p7]}, attempt, system, component) do
    %M.CommandLong{
      target_system: system,
      target_component: component,
      command: command,
      confirmation: min(attempt, 255),
      param1: float(p1),
      param2: float(p2),
      param3: float(p3),
      param4: float(p4),
      param5: float(p5),
      param6: float(p6),
      param7: float(p7)
    }
  end

  defp put({:int, command, frame, [p1, p2, p3, p4], place, z}, _attempt, system, component) do
    {x, y} =
      case place do
        nil -> {@no_place, @no_place}
        {lat, lon} -> {round(lat * 1.0e7), round(lon * 1.0e7)}
      end

    %M.CommandInt{
      target_system: system,
      target_component: component,
      frame: frame,
      command: command,
      param1: float(p1),
      param2: float(p2),
      param3: float(p3),
      param4: float(p4),
      x: x,
      y: y,
      z: float(z)
    }
  end

  defp put(
         {:message, %{target_system: _id, target_component: _component} = message},
         _attempt,
         system,
         component
       ),
       do: %{message | target_system: system, target_component: component}

  defp put({:message, %{target_system: _id} = message}, _attempt, system, _component),
    do: %{message | target_system: system}

  # MANUAL_CONTROL calls it target.
  defp put({:message, %{target: _id} = message}, _attempt, system, _component),
    do: %{message | target: system}

  defp float(:nan), do: :nan
  defp float(number), do: number * 1.0

  @doc """
  What a message says about a step: a COMMAND_ACK from the addressed component, for this command, to us or to nobody in
  particular (C7). The adapter handles everything else.
  """
  @spec read(
          Step.t(),
          struct(),
          Aerie.Vehicle.Protocol.source(),
          Vehicle.t(),
          long_frames :: [non_neg_integer()]
        ) ::
          Aerie.Vehicle.Protocol.answer()
  def read(%Step{acked?: true} = step, %M.CommandAck{} = ack, {system, component}, vehicle, long_frames) do
    if command(step) == ack.command and system == vehicle.system and
         component == (step.component || vehicle.component) and ours?(ack, vehicle.us),
       do: answer(ack, step, long_frames),
       else: :ignore
  end

  def read(_step, _message, _source, _vehicle, _long_frames), do: :ignore

  defp command(%Step{forms: [form | _others]}) do
    case form do
      {:long, command, _params} -> command
      {:int, command, _frame, _params, _place, _z} -> command
    end
  end

  # A MAVLink 1 vehicle, and one that broadcasts its answer, sends 0.
  defp ours?(ack, {system, component}),
    do: ack.target_system in [0, system] and ack.target_component in [0, component]

  defp answer(%{result: @accepted}, _step, _frames), do: :accepted

  defp answer(%{result: @in_progress, progress: share}, _step, _frames),
    do: {:progress, if(share <= 100, do: share / 100), nil}

  defp answer(%{result: @cancelled}, _step, _frames), do: :cancelled
  defp answer(%{result: @busy}, _step, _frames), do: {:busy, Refusal.text(:answered_busy)}

  # A repeated answer to the previous form.
  defp answer(%{result: @long_only}, %{forms: [{:long, _command, _params}]}, _frames), do: :ignore

  defp answer(%{result: @int_only}, %{forms: [{:int, _c, _frame, _params, _place, _z} | _more]}, _frames),
    do: :ignore

  defp answer(%{result: result}, step, frames) when result in [@long_only, @int_only, @other_frame] do
    case other_forms(result, step.forms, frames) do
      [] -> {:refused, :rejected, Refusal.text(:answered_form, result: name(result))}
      forms -> {:instead, %{step | forms: forms}}
    end
  end

  defp answer(%{result: result} = ack, _step, _frames) do
    status = if result in @rejections, do: :rejected, else: :failed
    {:refused, status, Refusal.text(:answered, result: name(result), code: more(ack))}
  end

  # Some commands have reasons of their own.
  defp more(%{result_param2: 0}), do: ""
  defp more(%{result_param2: code}), do: " (#{code})"

  defp name(result), do: if(name = MavResult.label(result), do: name, else: "with result #{result}")

  # Each refusal leaves fewer forms, so this ends.
  defp other_forms(@other_frame, [{:int, _command, _frame, _params, _place, _z} | others], _frames),
    do: others

  defp other_forms(@other_frame, _forms, _frames), do: []

  defp other_forms(@long_only, forms, frames) do
    # The firmware decides which frame a height in COMMAND_LONG refers to: in any other frame it would be another height.
    Enum.find_value(forms, [], fn
      {:int, command, frame, params, place, z} ->
        if z == :nan or frame in frames, do: [{:long, command, params ++ floats(place) ++ [z]}]

      _other ->
        nil
    end)
  end

  defp other_forms(@int_only, [{:long, command, params}], _frames) do
    case Enum.split(params, 4) do
      # COMMAND_INT can express it only if parameters 5 and 6 are not used.
      {first, [p5, p6, p7]} when p5 in [0, 0.0, :nan] and p6 in [0, 0.0, :nan] ->
        place = if p5 == :nan or p6 == :nan, do: nil, else: {0.0, 0.0}
        [{:int, command, 0, first, place, p7}]

      _floats ->
        []
    end
  end

  defp other_forms(@int_only, _forms, _frames), do: []

  defp floats(nil), do: [:nan, :nan]
  defp floats({lat, lon}), do: [lat, lon]

  @doc "The messages that carry a step's answers."
  @spec listens(Step.t()) :: [non_neg_integer()]
  def listens(%Step{acked?: true}), do: [M.CommandAck.id()]
  def listens(_step), do: []
end
