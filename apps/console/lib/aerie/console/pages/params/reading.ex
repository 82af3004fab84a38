defmodule Aerie.Console.Pages.Params.Reading do
  @moduledoc """
  Reads a vehicle's parameters, or what it says about them, for a page. The state is a value; a task does the work and sends messages to the
  page. The task ends with its last message, and the gateway keeps what was read for the next reader.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Params

  @enforce_keys [:ref, :id, :vehicle, :what]
  defstruct [:ref, :id, :vehicle, :what, :progress]

  @typedoc "The parameters of a component (nil: the autopilot), or the autopilot's descriptions of its own."
  @type what :: {:list, component :: 1..255 | nil} | :descriptions

  @typedoc "`:progress` - `%{\"phase\", \"done\", \"total\"}`, nil before the first message."
  @type t :: %__MODULE__{
          ref: reference(),
          id: String.t(),
          vehicle: String.t(),
          what: what(),
          progress: map() | nil
        }

  @doc """
  Starts reading. The calling process gets `{:command_progress, {:params, ref}, id, progress}`, and at the end `{:params, ref, answer}`:
  `{:ok, table}`, `{:ok, descriptions by name}` or `{:error, text}`.
  """
  @spec start(Names.gateway(), String.t(), what()) :: t()
  def start(gateway, vehicle, what) do
    {page, ref, id} = {self(), make_ref(), Aerie.Vehicle.Command.id()}

    {:ok, _pid} =
      Task.start(fn ->
        answer = read(gateway, vehicle, what, id: id, progress: {page, {:params, ref}})
        send(page, {:params, ref, answer(answer)})
      end)

    %__MODULE__{ref: ref, id: id, vehicle: vehicle, what: what}
  end

  defp read(gateway, vehicle, :descriptions, options), do: Params.metadata(gateway, vehicle, options)
  defp read(gateway, vehicle, {:list, nil}, options), do: Params.list(gateway, vehicle, options)

  defp read(gateway, vehicle, {:list, component}, options),
    do: Params.list(gateway, vehicle, [component: component] ++ options)

  defp answer({:ok, read}), do: {:ok, read}

  defp answer({:error, %{status: status, reason: reason}}),
    do: {:error, reason || Atom.to_string(status)}

  @doc "Cancels reading."
  @spec cancel(t(), Names.gateway()) :: :ok | {:error, String.t()}
  def cancel(reading, gateway), do: Params.cancel(gateway, reading.vehicle, reading.id)

  @doc "The progress, 0..1, or nil."
  @spec share(t()) :: float() | nil
  def share(%{progress: %{"done" => done, "total" => total}})
      when is_integer(done) and is_integer(total) and total > 0,
      do: min(done / total, 1.0)

  def share(_reading), do: nil
end
