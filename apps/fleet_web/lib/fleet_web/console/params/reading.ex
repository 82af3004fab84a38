defmodule FleetWeb.Console.Params.Reading do
  @moduledoc """
  Reads a vehicle's parameters for a page. The state is a value; a task does the work and sends messages to the page. The task ends with its
  last message, and the gateway keeps the list for the next reader.
  """

  alias Aerie.{Names, Params, Transfers}
  alias Aerie.Command.Result
  alias Aerie.Params.Table

  @enforce_keys [:ref, :id, :vehicle]
  defstruct [:ref, :id, :vehicle, :progress]

  @typedoc "`:progress` - `%{\"phase\", \"done\", \"total\"}`, nil before the first message."
  @type t :: %__MODULE__{ref: reference(), id: String.t(), vehicle: String.t(), progress: map() | nil}

  @doc """
  Starts reading. The calling process gets `{:command_progress, {:params, ref}, id, progress}`, and at the end `{:params, ref, answer}`:
  `{:ok, table}` or `{:error, text}`.
  """
  @spec start(Names.gateway(), String.t()) :: t()
  def start(gateway, vehicle) do
    {page, ref, id} = {self(), make_ref(), Aerie.Command.id()}

    {:ok, _pid} =
      Task.start(fn ->
        answer = Params.list(gateway, vehicle, id: id, progress: {page, {:params, ref}})
        send(page, {:params, ref, answer(answer)})
      end)

    %__MODULE__{ref: ref, id: id, vehicle: vehicle}
  end

  @spec answer({:ok, Table.t()} | {:error, Result.t()}) :: {:ok, Table.t()} | {:error, String.t()}
  defp answer({:ok, table}), do: {:ok, table}

  defp answer({:error, %Result{status: status, reason: reason}}),
    do: {:error, reason || Atom.to_string(status)}

  @doc "Cancels reading."
  @spec cancel(t(), Names.gateway()) :: :ok | {:error, String.t()}
  def cancel(reading, gateway), do: Transfers.cancel(gateway, reading.vehicle, reading.id)

  @doc "The progress, 0..1, or nil."
  @spec share(t()) :: float() | nil
  def share(%{progress: %{"done" => done, "total" => total}})
      when is_integer(done) and is_integer(total) and total > 0,
      do: min(done / total, 1.0)

  def share(_reading), do: nil
end
