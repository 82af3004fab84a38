defmodule Aerie.Fleet.Bridge.Forward.Hub do
  @moduledoc "What the hub's answers, and its refusals, say of it."

  # A connection that lasts longer was not refused. A busy hub needs a while to refuse one.
  @refused_ms 30_000

  @doc "Interprets the answer to `hub.info`: the hub is there, or why not."
  @spec answer(map()) :: :there | {:away, String.t()}
  def answer(%{status: "503"}), do: {:away, "there is no connection to it"}

  def answer(%{body: body}) do
    case JSON.decode(IO.iodata_to_binary(body)) do
      {:ok, %{"error" => %{"description" => text}}} -> {:away, text}
      {:ok, %{}} -> :there
      _other -> {:away, "it answers what is not understood"}
    end
  end

  @doc "Why the hub refused the leaf node's connection, nil if it did not; `leaf` is what `Aerie.Fleet.Bridge.Status.Tables` has of the connection."
  @spec refusal(map(), now :: integer()) :: String.t() | nil
  def refusal(%{problem: text, connected_at: at}, now) do
    if at == nil or now - at < @refused_ms, do: text
  end

  def refusal(_never_tried, _now), do: nil
end
