defmodule Aerie.Access.Tickets do
  @moduledoc """
  Tickets, each of which opens one WebSocket within half a minute.

  A browser cannot send a header with a WebSocket, and a key in an address ends up in logs. So a page requests a ticket with
  its key, and puts the ticket into the address or the subprotocol. It is valid once and for a short time. Only digests
  are kept, at most 1000.
  """
  use GenServer

  alias Aerie.Base.{Names, Principal}

  @life_ms 30_000
  @most 1_000

  @doc "Options: `:gateway`; for tests `:now`, a function that returns monotonic milliseconds."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :tickets))
  end

  @doc "Issues a ticket; returns it with its validity in seconds."
  @spec issue(Names.gateway(), Principal.t()) ::
          {:ok, String.t(), pos_integer()} | {:error, :too_many | :unavailable}
  def issue(gateway, principal) do
    ticket = Base.url_encode64(:crypto.strong_rand_bytes(24), padding: false)

    with {table, clock} <- Names.value(gateway, :tickets),
         now = clock.(),
         :ok <- add(table, now, {digest(ticket), principal, now + @life_ms}) do
      {:ok, ticket, div(@life_ms, 1000)}
    else
      nil -> {:error, :unavailable}
      {:error, reason} -> {:error, reason}
    end
  end

  defp add(table, now, row) do
    _expired = :ets.select_delete(table, [{{:_, :_, :"$1"}, [{:"=<", :"$1", now}], [true]}])

    if :ets.info(table, :size) < @most do
      true = :ets.insert(table, row)
      :ok
    else
      {:error, :too_many}
    end
  rescue
    # The process ended with its table meanwhile; so in `take/2`.
    ArgumentError -> {:error, :unavailable}
  end

  @doc "Uses up a ticket; gives the principal that it was issued to."
  @spec redeem(Names.gateway(), String.t()) :: {:ok, Principal.t()} | :error
  def redeem(gateway, ticket) when byte_size(ticket) <= 100 do
    with {table, clock} <- Names.value(gateway, :tickets),
         [{_digest, principal, until}] <- take(table, digest(ticket)),
         true <- until > clock.() do
      {:ok, principal}
    else
      _none_or_expired -> :error
    end
  end

  def redeem(_gateway, _ticket), do: :error

  # Atomic, so that only one of two requests with the same ticket succeeds.
  defp take(table, digest) do
    :ets.take(table, digest)
  rescue
    ArgumentError -> []
  end

  @impl GenServer
  def init(options) do
    table = :ets.new(:tickets, [:set, :public])
    clock = Keyword.get(options, :now, fn -> System.monotonic_time(:millisecond) end)
    Names.put_value(options[:gateway], :tickets, {table, clock})
    {:ok, table}
  end

  defp digest(ticket), do: :crypto.hash(:sha256, ticket)
end
