defmodule MavRouter.Forward.Gate.Questions do
  @moduledoc """
  Questions of those who may not ask a vehicle themselves (viewers, strangers): the gateway asks in its own name, within a budget that
  all of them share for each vehicle, if the answer is a message to everybody. A command that asks is acknowledged in the vehicle's name,
  because the vehicle acknowledges it to the gateway.

  Nothing of what the sender wrote goes on as it is: the gateway makes a command of the numbers, each of which
  must be an integer that its row allows. NaN, by which programs leave a parameter out, becomes 0, and so does a
  parameter that the definitions do not have. NaN as the number of what is asked for is an error. A question with
  an error is denied.
  """

  alias MavCodec.Meaning.Commands
  alias MavCodec.Meaning.Commands.Numbers
  alias MavCodec.Command
  alias MavRouter.Forward.Delivery
  alias MavRouter.Forward.Dispatch
  alias MavRouter.Endpoints.Output
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavRouter.Tables
  alias Aerie.Base.Store
  alias Aerie.Base.Timing.TokenBucket
  alias MavCodec.Enums.{MavCmd, MavResult}
  alias MavCodec.Frame
  alias MavCodec.Messages.{CommandAck, CommandInt, CommandLong}

  @minute_us 60_000_000
  # Commands that request data, whatever the data.
  @commands_per_minute 60
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @later MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  @denied MavResult.value(:MAV_RESULT_DENIED)
  # Up to here a float on the wire has every integer.
  @exact 16_777_215

  @doc """
  Asks a vehicle. `:not_askable` if the question has no known vehicle as its target, or if its answer is for the
  asker only;
  `:too_often` if there is no room in the budget; `:denied` if the gateway would not send such numbers.
  """
  @spec ask(Frame.t(), MavCodec.Meaning.Messages.row(), Delivery.t()) ::
          :asked | :too_often | :denied | :not_askable
  def ask(%Frame{} = frame, row, delivery) do
    command = Command.of(frame)
    per_minute = if command, do: @commands_per_minute, else: row.per_minute

    with true <- per_minute > 0,
         {_system, _component} = target <- Frame.target(frame),
         {_network, _id} = vehicle <- vehicle(target, delivery),
         {:ok, message} <- MavCodec.decode(frame),
         {_system, _component} = own <- Tables.setting(delivery.tables, :own, nil) do
      case own_words(message, command) do
        {:ok, message} ->
          room? = room?(delivery.tables, {vehicle, frame.id}, per_minute)
          _ = if room?, do: send_on(message, target, vehicle, own, frame, delivery)

          _ =
            if command,
              do: acknowledge(command, if(room?, do: @accepted, else: @later), target, frame, delivery)

          if room?, do: :asked, else: :too_often

        :error ->
          acknowledge(command, @denied, target, frame, delivery)
          :denied
      end
    else
      _no -> :not_askable
    end
  end

  # The other questions have names and integers only.
  defp own_words(message, nil), do: {:ok, message}

  defp own_words(%CommandInt{x: x, y: y, z: z} = m, command), do: long(m, command, [x, y, z])
  defp own_words(%CommandLong{} = m, command), do: long(m, command, [m.param5, m.param6, m.param7])

  defp long(m, command, last) do
    %{numbers: numbers} = Commands.get(command)
    numbers = Map.new(numbers)
    used = for %{reserved: false, index: n} <- MavCmd.params(command), do: n
    params = Enum.with_index([m.param1, m.param2, m.param3, m.param4 | last], 1)

    read =
      for {value, n} <- params,
          {:ok, f} <- [integer(value, n, numbers[n])],
          do: if(n in used, do: f, else: 0.0)

    with [p1, p2, p3, p4, p5, p6, p7] <- read do
      {:ok,
       %CommandLong{
         target_system: m.target_system,
         target_component: m.target_component,
         command: command,
         param1: p1,
         param2: p2,
         param3: p3,
         param4: p4,
         param5: p5,
         param6: p6,
         param7: p7
       }}
    else
      _one_is_wrong -> :error
    end
  end

  # The first is what is asked for, where it is an index.
  defp integer(value, 1, {:index, _min, _max}) when not is_number(value), do: :error

  defp integer(value, _n, kind) do
    with {:ok, number} <- Numbers.read(value, kind || {:index, -@exact, @exact}), do: {:ok, number * 1.0}
  end

  defp vehicle({id, _component}, %{gateway: gateway, path: path}) do
    Enum.find_value(path.networks, fn network ->
      system = Renumber.meant(path.renumber, network, id)
      if system != nil and Store.vehicle(gateway, {network, system}), do: {network, system}
    end)
  end

  defp send_on(
         message,
         {_id, component},
         {_network, system} = vehicle,
         {own_system, own_component},
         frame,
         delivery
       ) do
    version = Frame.version_for(frame, max(system, own_system))
    ids = [system: own_system, component: own_component, sysid32: true, version: version]
    bytes = MavCodec.encode(%{message | target_system: system}, ids)
    options = if component > 0, do: [component: component], else: []
    Dispatch.send(delivery.gateway, vehicle, bytes, options)
  end

  defp room?(%{limits: limits}, {vehicle, id}, per_minute) do
    key = {:asked_for, id, vehicle, 0}
    full = :ets.lookup_element(limits, key, 2, nil)
    burst = max(div(per_minute, 4), 1)

    case TokenBucket.take(full, System.monotonic_time(:microsecond), div(@minute_us, per_minute), burst) do
      {:ok, full} -> :ets.insert(limits, {key, full})
      :none -> false
    end
  end

  defp acknowledge(command, result, {system, component}, frame, %{path: path}) do
    if path.out != nil do
      ack = %CommandAck{
        command: command,
        result: result,
        target_system: frame.system,
        target_component: frame.component
      }

      ids = [system: system, component: max(component, 1), sysid32: true]
      bytes = MavCodec.encode(ack, [version: Frame.version_for(frame, system)] ++ ids)
      Output.bytes(path, bytes, :ack, 1)
    end
  end
end
