defmodule MavRouter.Recorder.Status do
  @moduledoc """
  The status of a recording, in the recorder's tables: written by its process once a second and when something changes. It stays when
  the recording is over, until its link or vehicle is removed.
  """

  alias Aerie.Base.Json.Object
  alias Aerie.Base.{Names, Store}
  alias MavRouter.Recorder.{Core, Recording, Tables}

  @typedoc "`fields/0` says what is what; `errors` are faults of the disk, `files` those that were written."
  @type t :: %{
          target: Tables.target(),
          label: String.t(),
          mode: Core.mode(),
          state: :off | :waiting | :recording | :paused,
          reason: String.t() | nil,
          file: Path.t() | nil,
          size: non_neg_integer,
          since: integer | nil,
          frames: non_neg_integer,
          bytes: non_neg_integer,
          files: non_neg_integer,
          dropped: non_neg_integer,
          errors: non_neg_integer,
          error: %{at: integer, reason: String.t()} | nil
        }

  @error Object.fields([
           {:time, {:time, :second}, nil, "when it was", :at},
           {:reason, :text, nil, "what it was"}
         ])
  @fields Object.fields([
            {:state, {:one_of, [:off, :waiting, :recording, :paused]}, nil,
             "off, waiting (for arming, or for a first frame), recording or paused"},
            {:mode, :text, nil, "always, armed or off; saving: the last minutes are being saved",
             &__MODULE__.shown_mode/1},
            {:reason, :text, nil, "why it is paused"},
            {:file, :text, nil, "name of the file that is being written", &__MODULE__.file_name/1},
            {:size, :integer, "B", "its size"},
            {:since, {:time, :second}, nil, "since when it is written"},
            {:frames, :integer, nil, "frames that were written since the gateway was started"},
            {:bytes, :integer, "B", "bytes that were written since then"},
            {:dropped, :integer, nil, "frames that could not be written"},
            {:error, {:object, @error}, nil, "the last fault of the disk:"}
          ])

  @doc "What is shown of a status."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc "What is shown of a fault of the disk."
  @spec error_fields() :: [Object.t()]
  def error_fields, do: @error

  @doc false
  @spec shown_mode(t) :: atom
  def shown_mode(%{mode: {:until, _at}}), do: :saving
  def shown_mode(%{mode: mode}), do: mode

  @doc false
  @spec file_name(t) :: String.t() | nil
  def file_name(%{file: file}), do: with(<<_path::binary>> <- file, do: Path.basename(file))

  @doc "The status for a recording's mode and output."
  @spec new(Core.mode(), Recording.Output.t()) :: t
  def new(mode, output) do
    Map.merge(output.totals, %{
      target: output.target,
      label: output.label,
      mode: mode,
      state: state(mode, output),
      reason: output.reason,
      file: output.file,
      size: output.size,
      since: output.since,
      error: output.error
    })
  end

  defp state(:off, _output), do: :off
  defp state(_mode, %{device: device}) when device != nil, do: :recording
  defp state(_mode, %{paused_until: until}) when until != nil, do: :paused
  defp state(_mode, _output), do: :waiting

  @spec put(Tables.t(), Tables.target(), t) :: true
  def put(tables, target, status), do: :ets.insert(tables.status, {target, status})

  @doc "The status of a target, nil when it was never recorded."
  @spec of(Tables.t(), Tables.target()) :: t | nil
  def of(tables, target), do: :ets.lookup_element(tables.status, target, 2, nil)

  @doc "All, in the order of their targets."
  @spec all(Tables.t()) :: [t]
  def all(tables), do: for({_target, status} <- Enum.sort(:ets.tab2list(tables.status)), do: status)

  @doc "Removes those of links and vehicles that the gateway no longer has, once nothing more is written."
  @spec sweep(Tables.t(), Names.gateway()) :: :ok
  def sweep(tables, gateway) do
    for target <- :ets.select(tables.status, [{{:"$1", :_}, [], [:"$1"]}]),
        Names.whereis(gateway, :recording, target) == nil and not known?(gateway, target),
        do: :ets.delete(tables.status, target)

    :ok
  end

  defp known?(gateway, {:link, id}), do: Store.link(gateway, id) != nil
  defp known?(gateway, {_vehicle_or_saved, key}), do: Store.vehicle(gateway, key) != nil

  @doc "The status of a target for its snapshot, without its names; nil for none."
  @spec summary(Tables.t(), Tables.target()) :: map | nil
  def summary(tables, target) do
    with %{} = status <- of(tables, target), do: Map.drop(status, [:target, :label])
  end
end
