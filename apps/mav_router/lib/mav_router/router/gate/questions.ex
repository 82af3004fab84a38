defmodule MavRouter.Router.Gate.Questions do
  @moduledoc """
  Questions of those who may not ask a vehicle themselves (viewers, strangers): the gateway asks in its own name, within a budget that
  all of them share for each vehicle, if the answer is a message to everybody. A command that asks is acknowledged in the vehicle's name,
  because the vehicle acknowledges it to the gateway.
  """

  alias MavCodec.CommandNumber
  alias MavRouter.Router.Delivery
  alias MavRouter.Router.Forward.Dispatch
  alias MavRouter.Router.Output
  alias MavRouter.Router.Owner.Renumber
  alias MavRouter.Router.Tables
  alias Aerie.Base.Store
  alias Aerie.Base.TokenBucket
  alias MavCodec.Enums.MavResult
  alias MavCodec.Frame
  alias MavCodec.Messages.CommandAck

  @minute_us 60_000_000
  # Commands that request data, whatever the data.
  @commands_per_minute 60
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @later MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)

  @doc """
  Asks a vehicle. `:not_askable` if the question has no known vehicle as its target, or if its answer is for the asker only;
  `:too_often` if there is no room in the budget.
  """
  @spec ask(Frame.t(), Authority.Messages.row(), Delivery.t()) :: :asked | :too_often | :not_askable
  def ask(%Frame{} = frame, row, delivery) do
    command = CommandNumber.of(frame)
    per_minute = if command, do: @commands_per_minute, else: row.per_minute

    with true <- per_minute > 0,
         {_system, _component} = target <- Frame.target(frame),
         {_network, _id} = vehicle <- vehicle(target, delivery),
         {:ok, message} <- MavCodec.decode(frame),
         {_system, _component} = own <- Tables.setting(delivery.tables, :own, nil) do
      room? = room?(delivery.tables, {vehicle, frame.id}, per_minute)
      _ = if room?, do: send_on(message, target, vehicle, own, delivery)

      _ =
        if command, do: acknowledge(command, if(room?, do: @accepted, else: @later), target, frame, delivery)

      if room?, do: :asked, else: :too_often
    else
      _no -> :not_askable
    end
  end

  defp vehicle({id, _component}, %{gateway: gateway, path: path}) do
    Enum.find_value(path.networks, fn network ->
      system = Renumber.meant(path.renumber, network, id)
      if system != nil and Store.vehicle(gateway, {network, system}), do: {network, system}
    end)
  end

  defp send_on(message, {_id, component}, {_network, system} = vehicle, {own_system, own_component}, delivery) do
    ids = [system: own_system, component: own_component, sysid32: true]
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

      bytes = MavCodec.encode(ack, system: system, component: max(component, 1), sysid32: true)
      Output.bytes(path, bytes, :ack, 1)
    end
  end
end
