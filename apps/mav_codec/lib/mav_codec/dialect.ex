defmodule MavCodec.Dialect do
  @moduledoc """
  A set of messages with their layouts, as parsers, routers and encoders need them.

  `MavCodec.Dialects.All` has all of upstream's messages and those that only ArduPilot has; `MavCodec.Dialects.Upstream`
  and `MavCodec.Dialects.Ardupilot` are the two sources, whose layouts differ in the extensions of a few messages; every
  definition file is a dialect too (`MavCodec.Dialects.Common`, `MavCodec.Dialects.Ardupilot.Common` ...).

  ## Your own dialect

      defmodule MyApp.Dialect do
        use MavCodec.Dialect, definitions: "my.xml"
      end

  compiles a definition file, and those that it includes, into a dialect. `definitions` is an XML file or a facts file
  that `mix mav.import` made; its path is relative to the file with the `use`. `base` is the source that has the included
  files that are not beside it: `"upstream"` (the default), `"ardupilot"`, or a folder of facts files.

  A message that equals an official one uses its module: `MyApp.Dialect` decodes a HEARTBEAT to a
  `MavCodec.Messages.Heartbeat`. Other messages get their own modules, `MyApp.Dialect.Messages.Camel`, as do new or longer
  enums: `MyApp.Dialect.Enums.Camel`.
  """

  @doc "The CRC_EXTRA of a message id, `nil` for an id that is not in the dialect (F5)."
  @callback crc_extra(id :: non_neg_integer()) :: 0..255 | nil

  @doc "The struct of a payload. Only an id that is not in the dialect is an error."
  @callback decode(id :: non_neg_integer(), payload :: binary()) ::
              {:ok, struct()} | {:error, MavCodec.Message.DecodeError.t()}

  @doc "The struct module of a message id."
  @callback module_for(id :: non_neg_integer()) :: module() | nil

  @doc "The payload's length without and with extensions."
  @callback length(id :: non_neg_integer()) :: {min :: 0..255, max :: 1..255} | nil

  @doc """
  Where in the payload the target system and the target component are (byte offsets; `nil` where there is none). A
  payload that is too short has zero there, which is "all" (F10). `nil` for a message without targets.
  """
  @callback targets(id :: non_neg_integer()) :: {system :: 0..254 | nil, component :: 0..254 | nil} | nil

  @doc "The name of a message id, such as `\"HEARTBEAT\"`."
  @callback name(id :: non_neg_integer()) :: String.t() | nil

  @doc "The id of a message name."
  @callback message_id(name :: String.t()) :: non_neg_integer() | nil

  @doc "All message ids, ascending."
  @callback ids() :: [non_neg_integer()]

  @doc "The wire layout of a struct module: fields in wire order as `{key, type, length}`, base and extensions."
  @callback layout(module()) ::
              {id :: non_neg_integer(), crc_extra :: 0..255, base :: list(), extensions :: list()} | nil

  @doc "How a struct module is encoded: id, CRC_EXTRA, length without extensions, and which of its layouts it is."
  @callback encoder(module()) ::
              {id :: non_neg_integer(), crc_extra :: 0..255, min :: 0..255, layout :: non_neg_integer()} | nil

  @doc false
  defmacro __using__(options) do
    {options, []} = Code.eval_quoted(options, [], __CALLER__)
    MavCodec.Definition.Custom.define(options, __CALLER__)
  end
end
