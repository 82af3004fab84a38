defmodule Aerie.Control.Operations.Fields do
  @moduledoc "The fields and parts of answers that several operations have, each described once."

  import Aerie.Base.Json.Schema

  alias Aerie.Base.Settings.Field
  alias Aerie.Control.{Missions, Params.LongNames}

  @largest 3.4028235e38
  # A parameter of MAVLink, or a longer one of a command line.
  @name "^([!-~]{1,16}|[a-z0-9_]{1,64})$"
  @base64 "^([A-Za-z0-9+/]{4})*([A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?$"
  # What a packet of MAVFTP has room for.
  @path_bytes 239

  @doc "See `Aerie.Base.Settings.Field.field/4`."
  @spec field(atom(), Field.type(), String.t(), keyword()) :: Field.t()
  defdelegate field(key, type, doc, options \\ []), to: Field

  @doc "The component whose parameters are meant."
  @spec component() :: Field.t()
  def component,
    do:
      field(
        :component,
        {:integer, 1, 255},
        "the component whose parameters are meant, such as 100, a camera; the autopilot if left out"
      )

  @doc "The name of a parameter."
  @spec param_name() :: Field.t()
  def param_name do
    check = &if(LongNames.name?(&1), do: {:ok, &1}, else: :error)
    words = "1 to 16 printable characters (Betaflight and iNav: to 64)"
    field(:name, {:term, check, words}, "the parameter's name", required: true, schema: name())
  end

  @doc "Several parameters with their values."
  @spec values() :: Field.t()
  def values do
    schema = %{
      type: :object,
      propertyNames: name(),
      additionalProperties: float32(),
      maxProperties: Aerie.Control.Params.Table.max()
    }

    check = &if(is_map(&1) and not is_struct(&1), do: {:ok, &1}, else: :error)
    words = "an object of names and numbers"
    field(:values, {:term, check, words}, "parameters with their values", schema: schema)
  end

  @doc "Which plan is meant."
  @spec kind() :: Field.t()
  def kind, do: field(:kind, {:enum, Missions.kinds()}, "which plan is meant", default: :mission)

  @doc "A file or folder on board."
  @spec path() :: Field.t()
  def path, do: field(:path, {:bytes, @path_bytes}, "a file or folder on board", required: true)

  @doc "An entry of the list of logs: that nobody goes on with another log of the same id, all of it is given."
  @spec log() :: Field.t()
  def log do
    words = "an entry of logs.list: id, size and time"
    field(:log, {:term, &read_log/1, words}, "an entry of `logs.list`", required: true, schema: log_schema())
  end

  defp read_log(%{"id" => id, "size" => size, "time" => time})
       when id in 0..0xFFFF and is_integer(size) and size >= 0 and (time == nil or is_integer(time)),
       do: {:ok, %{id: id, size: size, time: time}}

  defp read_log(_other), do: :error

  @doc "Bytes in base64."
  @spec base64() :: Field.t()
  def base64 do
    check = &if(is_binary(&1), do: Base.decode64(&1), else: :error)
    field(:data, {:term, check, "bytes in base64"}, "the bytes in base64", required: true, schema: data())
  end

  # --- Parts of answers

  @doc "The name of a parameter as programs give it."
  @spec name() :: Aerie.Base.Json.Schema.t()
  def name, do: %{type: :string, pattern: @name}

  @doc "A value of a parameter of the autopilot."
  @spec float32() :: Aerie.Base.Json.Schema.t()
  def float32, do: number(-@largest, @largest)

  @doc "A parameter that was read, by its properties."
  @spec param() :: %{atom() => Aerie.Base.Json.Schema.t()}
  def param do
    %{
      name: %{type: :string},
      value: described(%{type: [:number, :string, :null]}, "null: not a number on board"),
      type: described(integer(0, 255), "MAV_PARAM_TYPE"),
      default: described(%{type: [:number, :null]}, "the firmware's default, if the vehicle says it"),
      exact: described(%{type: :boolean}, "whether the value can be changed without a loss")
    }
  end

  @doc "A log as the vehicle lists it."
  @spec log_schema() :: Aerie.Base.Json.Schema.t()
  def log_schema do
    time = described(%{type: [:integer, :null]}, "unix time; null if the vehicle did not know it", "s")
    object(%{id: integer(0, 0xFFFF), size: count(), time: time}, [:id, :size])
  end

  @doc "Bytes in base64."
  @spec data() :: Aerie.Base.Json.Schema.t()
  def data, do: %{type: :string, pattern: @base64, contentEncoding: :base64}

  @doc "How many."
  @spec count() :: Aerie.Base.Json.Schema.t()
  def count, do: %{type: :integer, minimum: 0}
end
