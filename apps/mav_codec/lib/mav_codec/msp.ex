defmodule MavCodec.Msp do
  @moduledoc """
  MSP, the protocol of Betaflight and iNav: requests to a flight controller, and its replies. Pure functions.

      {frames, parser} = MavCodec.Msp.Parser.push(MavCodec.Msp.Parser.new(), bytes)
      {:ok, %{roll: roll}} = MavCodec.Msp.decode(hd(frames), {:betaflight, {1, 46}})
      {:ok, frame} = MavCodec.Msp.request({:betaflight, {1, 46}}, "SET_ACC_TRIM", %{pitch: 0, roll: 12})

  A target is a firmware and its version, as in `MavCodec.Msp.Messages`.
  """

  alias MavCodec.Msp.{Frame, Guard, Messages, Payload}

  @doc "The values of a frame: of the reply's or the request's layout, by its direction. A refusal has none."
  @spec decode(Frame.t(), Guard.target()) :: {:ok, Payload.values()} | {:error, String.t()}
  def decode(%Frame{direction: :error}, _target), do: {:ok, %{}}

  def decode(%Frame{id: id, direction: direction, payload: payload}, {firmware, version}) do
    case Messages.fetch(firmware, id) do
      {:ok, message} ->
        layout = if direction == :request, do: message.request, else: message.reply

        with {:error, why} <- Payload.decode(layout, payload, version),
             do: {:error, "#{message.name}: #{why}"}

      :error ->
        {:error, "message #{id} is not known of #{firmware}"}
    end
  end

  @doc """
  The request of a message, which has passed `MavCodec.Msp.Guard`. It is of version 1 if that has its id, unless `:form` says otherwise.

      iex> {:ok, frame} = MavCodec.Msp.request({:betaflight, {1, 48}}, "MSP2_GET_TEXT", %{type: 2})
      iex> MavCodec.Msp.Frame.encode(frame)
      "$X<" <> <<0, 6, 0x30, 1, 0, 2, 197>>
  """
  @spec request(Guard.target(), String.t(), Payload.values(), form: Frame.form()) ::
          {:ok, Frame.t()} | {:error, String.t()}
  def request({firmware, version} = target, name, values \\ %{}, options \\ []) do
    with {:ok, message} <- fetch(firmware, name),
         {:ok, payload} <- encode(message, values, version) do
      form = Keyword.get(options, :form, if(message.id > 254, do: :v2, else: :v1))
      frame = %Frame{form: form, id: message.id, payload: payload}
      with {:ok, _message} <- Guard.check(frame, target), do: {:ok, frame}
    end
  end

  defp fetch(firmware, name) do
    with :error <- Messages.fetch(firmware, name), do: {:error, "#{firmware} has no message #{name}"}
  end

  defp encode(message, values, version) do
    with {:error, why} <- Payload.encode(message.request, values, version),
         do: {:error, "#{message.name}: #{why}"}
  end
end
