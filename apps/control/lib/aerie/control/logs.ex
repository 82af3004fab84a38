defmodule Aerie.Control.Logs do
  @moduledoc """
  The logs on board a vehicle (LOG_* messages), for programs in Elixir:

      {:ok, logs} = Aerie.Control.Logs.list(gateway, "VID-001")
      {:ok, size} = Aerie.Control.Logs.download(gateway, "VID-001", hd(logs), "flight.bin")

  The options are those of `t:Aerie.Control.Transfers.option/0`. Where a vehicle shows its logs as files, `Aerie.Control.Files` reads them faster.

  After a restart of the vehicle a log may have another id. A restart ends a download, and before a download continues the vehicle is asked
  whether the id is still that of the same log.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Transfers
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Control.Logs.{Download, List}
  alias Aerie.Control.Transfers.{InOrder, Spool}
  alias Aerie.Vehicle.{Firmware, Snapshot}

  @list_ms 600_000
  @byte_ms 4

  @doc "The logs in the order of their ids."
  @spec list(Names.gateway(), vehicle :: String.t(), [Transfers.option()]) ::
          {:ok, [List.entry()]} | {:error, Result.t()}
  def list(gateway, vehicle, options \\ []), do: entries(gateway, vehicle, nil, options)

  @doc "The log with an id; a vehicle without it is `:rejected` with the rule `\"log\"`."
  @spec entry(Names.gateway(), vehicle :: String.t(), 0..65_535, [Transfers.option()]) ::
          {:ok, List.entry()} | {:error, Result.t()}
  def entry(gateway, vehicle, id, options \\ []) do
    with {:ok, found} <- entries(gateway, vehicle, id, options) do
      case found do
        [entry] -> {:ok, entry}
        [] -> Transfers.error(Refusal.deny(:no_log, id: id), options)
      end
    end
  end

  @doc """
  The log of a list as it is now: the same id and time, and not smaller, since a vehicle may still write it. Otherwise it is another one,
  `:rejected` with the rule `"log"`.
  """
  @spec same(Names.gateway(), vehicle :: String.t(), List.entry(), [Transfers.option()]) ::
          {:ok, List.entry()} | {:error, Result.t()}
  def same(gateway, vehicle, entry, options \\ []) do
    with {:ok, now} <- entry(gateway, vehicle, entry.id, options) do
      if now.time == entry.time and now.size >= entry.size,
        do: {:ok, now},
        else: Transfers.error(Refusal.deny(:another_log, id: entry.id), options)
    end
  end

  @doc """
  Folds the bytes of a log from `offset` on, in their order, and returns its size. If the vehicle restarts meanwhile, the result is `:failed`:
  list the logs again, and continue with the one of the same size and time.
  """
  @spec fold(
          Names.gateway(),
          vehicle :: String.t(),
          List.entry(),
          offset :: non_neg_integer(),
          acc,
          (iodata(), acc -> acc),
          [Transfers.option()]
        ) :: {{:ok, non_neg_integer()} | {:error, Result.t()}, acc}
        when acc: term()
  def fold(gateway, vehicle, entry, offset, acc, fun, options \\ []) do
    case Transfers.vehicle(gateway, vehicle) do
      {:ok, snapshot} ->
        {result, {_order, acc}} =
          read(gateway, snapshot, entry, offset, options, {InOrder.new(offset), acc}, fn
            {:data, at, bytes}, {order, acc} ->
              {bytes, order} = InOrder.put(order, at, bytes)
              {order, if(bytes == [], do: acc, else: fun.(bytes, acc))}
          end)

        {result, acc}

      error ->
        {error, acc}
    end
  end

  @doc """
  Downloads a log of the list into a file of this machine, and returns its size. The name is `path` with `.part` until the file is complete.
  If such a file exists, the download continues at its end, if the vehicle still has the same log (`same/4`).
  """
  @spec download(Names.gateway(), vehicle :: String.t(), List.entry(), Path.t(), [Transfers.option()]) ::
          {:ok, non_neg_integer()} | {:error, Result.t()}
  def download(gateway, vehicle, entry, path, options \\ []) do
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle) do
      Spool.fill(path, :asks, fn offset, acc, fun ->
        with {:ok, entry} <- if(offset > 0, do: same(gateway, vehicle, entry, options), else: {:ok, entry}) do
          read(gateway, snapshot, entry, min(offset, entry.size), options, acc, fun)
        else
          error -> {error, acc}
        end
      end)
    end
  end

  defp read(gateway, snapshot, entry, offset, options, acc, fun) do
    transfer = %{
      lanes: [:log],
      timeout_ms: Transfers.time_ms(entry.size, @byte_ms),
      start: fn context, until ->
        {:ok, Download.new(entry, context.target, until, offset: offset, rtt_us: context.rtt_us)}
      end
    }

    Transfers.read(gateway, snapshot, transfer, options, acc, fun)
  end

  # All of them, or the one with an id.
  defp entries(gateway, vehicle, only, options) do
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle) do
      transfer = %{
        lanes: [:log],
        timeout_ms: @list_ms,
        share: {:logs, only},
        start: fn context, until ->
          {:ok, List.new(context.target, until, rtt_us: context.rtt_us, only: only)}
        end
      }

      {result, nil} = Transfers.read(gateway, snapshot, transfer, options)
      silent(result, snapshot)
    end
  end

  defp silent({:error, %{status: :timeout} = result}, %{autopilot: firmware} = snapshot) do
    %{title: title, logs_armed?: answers?} = Firmware.traits(firmware)

    if Snapshot.data(snapshot, :mode)[:armed] and not answers?,
      do:
        {:error, %{result | reason: "#{title} does not speak of its logs while it is armed: disarm it first"}},
      else: {:error, result}
  end

  defp silent(result, _snapshot), do: result
end
