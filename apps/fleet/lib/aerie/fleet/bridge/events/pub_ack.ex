defmodule Aerie.Fleet.Bridge.Events.PubAck do
  @moduledoc "JetStream's answer to a published event. Pure."

  @typedoc "`:no_stream`: no stream has this subject; else a reason of `Aerie.Fleet.Nats`."
  @type reason :: :no_stream | :not_understood | Aerie.Fleet.Nats.reason()

  # message size exceeds maximum allowed
  @too_large 10_054

  @doc "The number of the sending that is answered, and the answer."
  @spec parse(Aerie.Fleet.Nats.message(), String.t() | nil) ::
          {:confirmed, pos_integer(), duplicate? :: boolean()} | {:refused, pos_integer(), reason()} | :other
  def parse(%{topic: topic} = message, inbox) when is_binary(inbox) do
    with [^inbox, ref] <- String.split(topic, ~r/\.(?=[^.]*\z)/),
         {ref, ""} <- Integer.parse(ref) do
      body(message, ref)
    else
      _ -> :other
    end
  end

  def parse(_message, nil), do: :other

  defp body(%{status: "503"}, ref), do: {:refused, ref, :no_stream}

  defp body(%{body: body}, ref) do
    case body |> IO.iodata_to_binary() |> JSON.decode() do
      {:ok, %{"error" => %{} = error}} -> {:refused, ref, error}
      {:ok, %{"stream" => _, "seq" => _} = ack} -> {:confirmed, ref, ack["duplicate"] == true}
      _ -> {:refused, ref, :not_understood}
    end
  end

  @doc "Whether sending the same message again is useless."
  @spec hopeless?(reason()) :: boolean()
  def hopeless?(%{"err_code" => @too_large}), do: true
  def hopeless?({:too_large, _bytes, _max}), do: true
  def hopeless?(_reason), do: false

  @doc "A reason as text."
  @spec text(reason()) :: String.t()
  def text(:no_stream), do: "there is no stream for them"
  def text(:not_understood), do: "an answer that is not understood"
  def text(reason), do: Aerie.Fleet.Nats.text(reason)
end
