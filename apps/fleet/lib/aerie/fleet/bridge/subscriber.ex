defmodule Aerie.Fleet.Bridge.Subscriber do
  @moduledoc """
  What processes have in common that read from NATS beside the bridge: a subscription that follows the bridge's connection, and
  answers to requests.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Fleet.{Bridge, Nats}
  alias Aerie.Control.Policy.Sources

  @doc """
  Subscribes this process to a subject, or several, with each new connection. `state` has `:gateway` and `:conn`, the connection that is subscribed, nil for
  none; call this at the start and for each `{:fleet, :bridge, {:connection, info}}`. Options are those of `Nats.sub/4`.
  """
  @spec follow(state, String.t() | [String.t()], keyword()) :: state
        when state: %{:gateway => term(), :conn => pid() | nil, optional(atom()) => term()}
  def follow(state, subjects, options \\ []) do
    conn = Bridge.connection(state.gateway)

    with true <- conn != nil and conn != state.conn,
         :ok <- all(List.wrap(subjects), &Nats.sub(conn, self(), &1, options)) do
      %{state | conn: conn}
    else
      false -> %{state | conn: conn}
      # The connection was lost; the next one subscribes.
      {:error, _lost} -> %{state | conn: nil}
    end
  end

  defp all(subjects, subscribe) do
    Enum.find_value(subjects, :ok, fn subject ->
      with {:ok, _sid} <- subscribe.(subject), do: nil
    end)
  end

  @doc "Whether a message claims the signature of a listed key, which floods of others must not keep away."
  @spec signed?(Names.gateway(), Nats.message()) :: boolean()
  def signed?(gateway, message) do
    with {_name, header} <- List.keyfind(message[:headers] || [], "aerie-signature", 0),
         now = System.os_time(:microsecond),
         {:listed, _key} <- Sources.claim(Policy.Store.get(gateway), header, now) do
      Sources.fresh?(header, now)
    else
      _not_listed -> false
    end
  end

  @doc "The answer that refuses a request."
  @spec refusal(rule :: String.t(), reason :: String.t()) :: %{String.t() => String.t()}
  def refusal(rule, reason), do: %{"result" => "refused", "rule" => rule, "reason" => reason}

  @doc "Answers a request; a message without a reply subject is none."
  @spec reply(map(), map()) :: :ok
  def reply(%{reply_to: nil}, _body), do: :ok

  def reply(message, body) do
    # A client without an answer asks again.
    _ = Nats.pub(message.gnat, message.reply_to, JSON.encode_to_iodata!(body))
    :ok
  end
end
