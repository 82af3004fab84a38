defmodule FleetWeb.API.Tickets do
  @moduledoc """
  Tickets, each of which lets its bearer open one WebSocket within half a minute.

  A browser cannot send a header with a WebSocket, and a key in an address ends up in logs. So a page requests a ticket with
  its key, and puts the ticket into the address or the subprotocol. It is valid once and for a short time. Only digests
  are kept, at most 1000.
  """
  use GenServer

  alias Aerie.Names

  @life_ms 30_000
  @most 1_000

  @doc "Options: `:gateway`; for tests `:now`, a function that returns monotonic milliseconds."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :tickets))
  end

  @doc "Issues a ticket for `name`; returns it with its validity in seconds."
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

  @doc "Uses up a ticket and returns the name that it was issued for."
  @spec redeem(Names.gateway(), String.t()) :: {:ok, String.t()} | :error
  def redeem(gateway, ticket) when byte_size(ticket) <= 100 do
    Names.with_value(gateway, :tickets, :error, fn {table, now} ->
      # Taken atomically, so that only one of two requests with the same ticket succeeds.
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
