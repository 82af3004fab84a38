defmodule Aerie.Bridge.Subscriber do
  @moduledoc """
  What processes have in common that read from NATS beside the bridge: a subscription that follows the bridge's connection, and
  answers to requests.
  """

  alias Aerie.Bridge

  @doc """
  Subscribes this process with each new connection. `state` has `:gateway` and `:conn`, the connection that is subscribed, nil for
  none; call this at the start and for each `{:fleet, :bridge, {:connection, info}}`. Options are those of `Gnat.sub/4`.
  """
  @spec follow(state, String.t(), keyword()) :: state
        when state: %{:gateway => term(), :conn => pid() | nil, optional(atom()) => term()}
  def follow(state, subject, options \\ []) do
    conn = Bridge.connection(state.gateway)

    with true <- conn != nil and conn != state.conn,
         {:ok, _sid} <- Gnat.sub(conn, self(), subject, options) do
      %{state | conn: conn}
    else
      false -> %{state | conn: conn}
      # The connection was lost; the next one subscribes.
      {:error, _lost} -> %{state | conn: nil}
    end
  catch
    :exit, _gone -> %{state | conn: nil}
  end

  @doc "The answer that refuses a request."
  @spec refusal(rule :: String.t(), reason :: String.t()) :: %{String.t() => String.t()}
  def refusal(rule, reason), do: %{"result" => "refused", "rule" => rule, "reason" => reason}

  @doc "Answers a request; a message without a reply subject is none."
  @spec reply(map(), map()) :: :ok
  def reply(%{reply_to: nil}, _body), do: :ok

  def reply(message, body) do
    # A client without an answer asks again.
    _ = Gnat.pub(message.gnat, message.reply_to, JSON.encode_to_iodata!(body))
    :ok
  catch
    :exit, _gone -> :ok
  end
end
