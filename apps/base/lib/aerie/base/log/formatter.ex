defmodule Aerie.Base.Log.Formatter do
  @moduledoc """
  Formats a log event as one line: logfmt (`time=… level=info msg="…" link=radio1`), or a JSON object with the same keys.

  Every line begins with the time (UTC, milliseconds), the level and the message. Then follow the subject (`gateway` unless it
  is the only one, `link`, `vehicle`) and further pairs of the event. The subject of a process that says nothing itself, as
  when it crashes, is taken from its label (`Process.set_label/1`): `{:link, id}` gives `link=id`.

  A line is bounded, has no control characters, is valid UTF-8, and shows no secrets (`Aerie.Base.Log.Redact`).
  """

  alias Aerie.Base.Log.Redact
  alias Aerie.Base.Printable

  @type format :: :logfmt | :json

  @max_message 8_192
  @max_value 1_024
  @max_pairs 40

  # The metadata that is written, in this order; what else a library attaches is left out.
  @subject [:gateway, :link, :vehicle]

  # The first element of labels, and whose id the second one is.
  @labels %{
    link: :link,
    link_tree: :link,
    opener: :link,
    vehicle: :vehicle,
    session: :vehicle,
    shadow: :vehicle
  }

  @doc "The formatter as `:logger` takes it."
  @spec new(format()) :: {module(), %{format: format()}}
  def new(format \\ :logfmt) when format in [:logfmt, :json], do: {__MODULE__, %{format: format}}

  @doc false
  @spec check_config(map()) :: :ok | {:error, term()}
  def check_config(%{format: format}) when format in [:logfmt, :json], do: :ok
  def check_config(other), do: {:error, {:invalid_formatter_config, __MODULE__, other}}

  @doc "A line of the log, from an event of `:logger`. `fields` in the metadata has further pairs."
  @spec format(:logger.log_event(), %{format: format()}) :: iodata()
  def format(%{level: level, meta: meta} = event, %{format: format}) do
    text = event |> Logger.Formatter.format_event(@max_message) |> IO.chardata_to_string()
    line(format, meta[:time] || System.os_time(:microsecond), level, text, subject(meta) ++ fields(meta))
  rescue
    # A formatter that raises loses its handler.
    error -> line(format, System.os_time(:microsecond), level, "unprintable: #{inspect(error)}", [])
  end

  @doc "A line of its own: time in unix microseconds, level, message, pairs. A pair whose value is nil is left out."
  @spec line(format(), integer(), atom(), String.t(), [{atom() | String.t(), term()}]) :: iodata()
  def line(format, time, level, message, pairs) do
    stamp =
      time |> DateTime.from_unix!(:microsecond) |> DateTime.truncate(:millisecond) |> DateTime.to_iso8601()

    pairs = for {key, value} <- flat(pairs), value != nil, do: {key(key), value(value, @max_value)}
    pairs = [{"msg", value(message, @max_message)} | Enum.take(pairs, @max_pairs)]
    encode(format, [{"time", stamp}, {"level", to_string(level)} | pairs])
  end

  defp encode(:logfmt, pairs),
    do: [Enum.map_intersperse(pairs, " ", fn {key, value} -> [key, "=", quoted(value)] end), "\n"]

  defp encode(:json, pairs) do
    members =
      Enum.map_intersperse(pairs, ",", fn {key, value} -> [JSON.encode!(key), ":", JSON.encode!(value)] end)

    [Printable.lines(["{", members, "}"]), "\n"]
  end

  defp subject(meta) do
    told = for key <- @subject, value = meta[key], value not in [:default, ":default"], do: {key, value}

    case labelled(meta) do
      nil -> told
      {key, id} -> if List.keymember?(told, key, 0), do: told, else: told ++ [{key, id}]
    end
  end

  # Only the process itself can be asked; events are formatted in the process that logs.
  defp labelled(%{pid: pid}) when pid == self() do
    case :proc_lib.get_label(self()) do
      label when is_tuple(label) and tuple_size(label) in 2..3 ->
        key = @labels[elem(label, 0)]
        if key && is_binary(elem(label, 1)), do: {key, elem(label, 1)}

      _other ->
        nil
    end
  end

  defp labelled(_meta), do: nil

  defp fields(%{fields: fields}) when is_list(fields) or is_map(fields), do: Enum.to_list(fields)
  defp fields(_meta), do: []

  # `position: %{lat: 1}` becomes `position.lat=1`.
  defp flat(pairs) do
    Enum.flat_map(pairs, fn
      {key, inner} when is_map(inner) and not is_struct(inner) ->
        for {name, value} <- inner |> Enum.sort() |> flat(), do: {"#{key}.#{name}", value}

      pair ->
        [pair]
    end)
  end

  defp key(key), do: key |> to_string() |> String.replace(~r/[^A-Za-z0-9_.-]/, "_")

  defp value(value, _max) when is_number(value) or is_boolean(value), do: value
  defp value(value, max) when is_atom(value), do: value |> Atom.to_string() |> value(max)

  defp value(value, max) when is_binary(value) do
    value |> String.replace_invalid() |> cut(max) |> Redact.text()
  end

  defp value(value, max), do: value |> inspect(limit: 20, printable_limit: 200) |> value(max)

  defp cut(text, max) when byte_size(text) <= max, do: text

  defp cut(text, max) do
    text |> binary_part(0, max) |> String.replace_invalid("") |> Kernel.<>("… (#{byte_size(text)} bytes)")
  end

  defp quoted(value) when not is_binary(value), do: to_string(value)

  defp quoted(value) do
    if value =~ ~r/\A[^\s"=\\[:cntrl:]]+\z/u and Printable.line(value) == value,
      do: value,
      else: [?", ~r/["\\]|[[:cntrl:]]/u |> Regex.replace(value, &escape/1) |> Printable.lines(), ?"]
  end

  defp escape("\n"), do: "\\n"
  defp escape("\r"), do: "\\r"
  defp escape("\t"), do: "\\t"
  defp escape(sign) when sign in ["\"", "\\"], do: "\\" <> sign

  defp escape(control), do: Printable.escape(control)
end
