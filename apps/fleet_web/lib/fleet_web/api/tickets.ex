defmodule FleetWeb.API.Tickets do
  @moduledoc """
  Tickets: let their bearer open one WebSocket within half a minute.

  A browser cannot send a header with a WebSocket, and a key in an address ends up in logs. So it asks for a ticket with
  its key and puts that into the address or the subprotocol: it is worthless once used, and soon in any case. Only digests
  are kept, at most 1000.
  """
  use GenServer

  alias Aerie.Names

  @life_ms 30_000
  @most 1_000

  @doc "Options: `:gateway`; for tests `:now`, a function that gives monotonic milliseconds."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :tickets))
  end

  @doc "A ticket for `name`, and for how many seconds it holds."
  @spec issue(Names.gateway(), String.t()) ::
          {:ok, String.t(), pos_integer()} | {:error, :too_many | :unavailable}
  def issue(gateway, name) do
    Names.with_value(gateway, :tickets, {:error, :unavailable}, fn {table, now} ->
      _ = sweep(table, now.())

      if :ets.info(table, :size) < @most do
        ticket = Base.url_encode64(:crypto.strong_rand_bytes(24), padding: false)
        :ets.insert(table, {digest(ticket), name, now.() + @life_ms})
        {:ok, ticket, div(@life_ms, 1000)}
      else
        {:error, :too_many}
      end
    end)
  end

  @doc "Who the ticket was given to; it is used up by this."
  @spec redeem(Names.gateway(), String.t()) :: {:ok, String.t()} | :error
  def redeem(gateway, ticket) when byte_size(ticket) <= 100 do
    Names.with_value(gateway, :tickets, :error, fn {table, now} ->
      # Taken in one step: of two that come with the same ticket, one gets in.
      case :ets.take(table, digest(ticket)) do
        [{_digest, name, until}] -> if until > now.(), do: {:ok, name}, else: :error
        [] -> :error
      end
    end)
  end

  def redeem(_gateway, _ticket), do: :error

  @impl GenServer
  def init(options) do
    table = :ets.new(:tickets, [:set, :public])
    now = Keyword.get(options, :now, fn -> System.monotonic_time(:millisecond) end)
    Names.put_value(options[:gateway], :tickets, {table, now})
    {:ok, table}
  end

  defp sweep(table, now), do: :ets.select_delete(table, [{{:_, :_, :"$1"}, [{:"=<", :"$1", now}], [true]}])

  defp digest(ticket), do: :crypto.hash(:sha256, ticket)
end
