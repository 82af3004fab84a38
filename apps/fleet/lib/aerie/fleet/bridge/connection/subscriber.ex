defmodule Aerie.Fleet.Bridge.Connection.Subscriber do
  @moduledoc """
  A subscription that follows the bridge's connection.
  """

  alias Aerie.Fleet.{Bridge, Nats}

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
end
