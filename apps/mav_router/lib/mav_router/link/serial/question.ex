defmodule MavRouter.Link.Serial.Question do
  @moduledoc """
  What a search for a flight controller with MSP asks of a silent port, and what the answer says of it: its firmware (FC_VARIANT), which all of
  them have had since before MSP had versions.
  """

  alias MavCodec.Msp.{Frame, Parser}
  alias MavCodec.Sniff
  alias MavRouter.Link.Serial.Finding

  @id 2
  @vehicles %{"BTFL" => "Betaflight", "INAV" => "iNav"}

  @doc "The request: the same bytes in every firmware."
  @spec bytes() :: binary
  def bytes, do: %Frame{id: @id} |> Frame.encode() |> IO.iodata_to_binary()

  @doc "What the bytes that came say of the port; nil if they do not answer."
  @spec answer(binary, Path.t(), pos_integer) :: Finding.t() | nil
  def answer(bytes, path, baud) do
    {frames, parser} = Parser.push(Parser.new(), bytes)

    cond do
      reply = Enum.find(frames, &match?(%{id: @id, direction: :reply}, &1)) ->
        variant(reply.payload, path, baud)

      # A command line sends back what can be printed of it.
      Enum.any?(frames, &match?(%{id: @id, direction: :request}, &1)) or Parser.pending(parser) == "$M<" ->
        finding(
          path,
          baud,
          :other_protocol,
          "our own question comes back",
          "its command line is open, or the line is looped back"
        )

      Sniff.classify(bytes).heartbeat ->
        finding(
          path,
          baud,
          :other_protocol,
          "it speaks MAVLink",
          "its connection string is serial:auto or DEVICE,BAUD"
        )

      true ->
        nil
    end
  end

  defp variant(<<variant::binary-size(4), _::binary>>, path, baud) when is_map_key(@vehicles, variant),
    do: finding(path, baud, :vehicle, "answers as #{@vehicles[variant]}", nil)

  defp variant(other, path, baud) do
    name = for <<byte <- binary_slice(other, 0, 8)>>, byte in 33..126, into: "", do: <<byte>>
    finding(path, baud, :other_protocol, ~s(answers as "#{name}"), "neither Betaflight nor iNav")
  end

  defp finding(path, baud, condition, evidence, advice),
    do: %Finding{
      path: path,
      condition: condition,
      protocol: :msp1,
      baud: baud,
      evidence: evidence,
      advice: advice
    }
end
