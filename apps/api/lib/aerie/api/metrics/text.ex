defmodule Aerie.Api.Metrics.Text do
  @moduledoc """
  Renders metric families as iodata in Prometheus' text exposition format 0.0.4. Pure.

  A sample with an unknown value (nil) is left out, because a made-up zero would look like a measurement.
  """

  @type labels :: [{String.t() | atom(), term()}]
  @typedoc "A sample of a histogram has the end of its name (`_bucket`, `_sum`, `_count`) in front."
  @type sample ::
          {labels(), number() | boolean() | nil}
          | {ending :: String.t(), labels(), number() | boolean() | nil}
  @type family :: {name :: String.t(), :counter | :gauge | :histogram, help :: String.t(), [sample()]}

  @doc "The content type of this format."
  @spec content_type() :: String.t()
  def content_type, do: "text/plain; version=0.0.4; charset=utf-8"

  @doc "Renders the families that have at least one known sample."
  @spec render([family()]) :: iodata()
  def render(families), do: Enum.map(families, &family/1)

  defp family({name, type, help, samples}) do
    case for sample <- samples,
             {ending, labels, value} = whole(sample),
             value != nil,
             do: [name, ending, labels(labels), " ", number(value), "\n"] do
      [] -> []
      lines -> ["# HELP ", name, " ", help, "\n# TYPE ", name, " ", Atom.to_string(type), "\n", lines]
    end
  end

  defp whole({labels, value}), do: {"", labels, value}
  defp whole({_ending, _labels, _value} = sample), do: sample

  defp labels([]), do: []

  defp labels(labels) do
    pairs =
      Enum.map_intersperse(labels, ",", fn {key, value} -> [to_string(key), "=\"", escape(value), "\""] end)

    ["{", pairs, "}"]
  end

  defp escape(value) do
    value
    |> to_string()
    |> String.replace("\\", "\\\\")
    |> String.replace("\"", "\\\"")
    |> String.replace("\n", "\\n")
  end

  defp number(true), do: "1"
  defp number(false), do: "0"
  defp number(value) when is_integer(value), do: Integer.to_string(value)
  defp number(value) when is_float(value), do: Float.to_string(value)
end
