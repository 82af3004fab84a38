defmodule Aerie.Incident.Plot do
  @moduledoc """
  Plots over the time of an incident as SVG. All have the same scale of time, so that what happened at once stands below each other. Pure.
  """

  import Aerie.Incident.Html

  alias Aerie.Incident.{Series, Span}

  @width 960
  @left 58
  @right 12
  @top 6
  @inner @width - @left - @right
  @height 84
  @foot 18
  # State that does not change is published every 30 s; a longer gap is a gap.
  @gap_us 35_000_000
  @steps [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1_800, 3_600, 7_200, 14_400, 21_600, 43_200, 86_400]
  @max_marks 400

  @doc "Width of the drawing, and where the scale of time begins and how long it is, for the cursor."
  @spec measures() :: {pos_integer(), pos_integer(), pos_integer()}
  def measures, do: {@width, @left, @inner}

  @doc "A curve with its scale; marks are the rows of `Aerie.Incident.Timeline`."
  @spec curve([Series.point()], String.t(), Span.t(), [map()]) :: iodata()
  def curve(points, title, span, marks) do
    {low, high, ticks} = points |> Enum.map(&elem(&1, 1)) |> Enum.min_max() |> scale()
    y = fn value -> @top + @height * (high - value) / (high - low) end

    svg(title, @height + @top + @foot, [
      for(tick <- ticks, do: tick(tick, y.(tick))),
      times(span, @top + @height),
      marks(marks, span, @top + @height),
      for(part <- parts(points, span), do: line(part, span, y))
    ])
  end

  @doc "Intervals with a value each, such as the mode: `changes` are `{at, value}`, and `last` is when the last of them was still known."
  @spec bands([{integer(), term()}], String.t(), Span.t(), integer(), (term() -> {String.t(), String.t()})) ::
          iodata()
  def bands(changes, title, span, last, show) do
    ends = changes |> Enum.drop(1) |> Enum.map(&elem(&1, 0)) |> Enum.concat([max(last, span.from)])

    svg(title, 24, [
      for {{from, value}, to} <- Enum.zip(changes, ends) do
        {x, until} = {x(from, span), x(to, span)}
        {text, class} = show.(value)
        width = max(until - x, 0.5)

        [
          ~s(<g class="#{class}"><title>#{clock(from)} #{text(text)}</title>),
          ~s(<rect x="#{coordinate(x)}" y="2" width="#{coordinate(width)}" height="18"/>),
          if(width > 7 * String.length(text) + 6,
            do: ~s(<text x="#{coordinate(x + 4)}" y="15">#{text(text)}</text>),
            else: []
          ),
          "</g>"
        ]
      end
    ])
  end

  @doc "The marks of what happened, each a link to its row of the table."
  @spec lane([map()], String.t(), Span.t()) :: iodata()
  def lane(rows, title, span) do
    svg(title, 24, [
      ~s(<line class="grid" x1="#{@left}" x2="#{@width - @right}" y1="18" y2="18"/>),
      for row <- marked(rows) do
        x = x(row.at, span)

        shape =
          Enum.map_join([{x - 5, 4}, {x + 5, 4}, {x, 17}], " ", fn {x, y} -> "#{coordinate(x)},#{y}" end)

        ~s(<a href="#r#{row.n}"><polygon class="#{row.kind}" points="#{shape}"><title>#{tenths(row.at)} #{text(row.what)} ) <>
          ~s(#{text(row.decision)} #{text(row.result)}</title></polygon></a>)
      end
    ])
  end

  defp svg(title, height, content) do
    [
      ~s(<svg class="plot" viewBox="0 0 #{@width} #{height}" role="img" aria-label="#{text(title)}">),
      content,
      ~s(<line class="cursor" y1="0" y2="#{height}" x1="-9" x2="-9"/></svg>)
    ]
  end

  defp line(part, span, y) do
    case part do
      [{at, value}] ->
        ~s(<circle cx="#{coordinate(x(at, span))}" cy="#{coordinate(y.(value))}" r="2"/>)

      points ->
        places = for {at, value} <- points, do: [coordinate(x(at, span)), ?,, coordinate(y.(value)), ?\s]
        [~s(<polyline points="), places, ~s("/>)]
    end
  end

  # A curve is interrupted where nothing was known.
  defp parts(points, span) do
    gap = max(@gap_us, div(span.to - span.from, 150))

    Enum.chunk_while(
      points,
      [],
      fn
        {at, _value} = point, [{before, _} | _] = part when at - before > gap ->
          {:cont, Enum.reverse(part), [point]}

        point, part ->
          {:cont, [point | part]}
      end,
      &{:cont, Enum.reverse(&1), []}
    )
  end

  defp x(at, span) do
    part = (at - span.from) / (span.to - span.from)
    @left + @inner * (part |> max(0.0) |> min(1.0))
  end

  defp tick(value, y) do
    [
      ~s(<line class="grid" x1="#{@left}" x2="#{@width - @right}" y1="#{coordinate(y)}" y2="#{coordinate(y)}"/>),
      ~s(<text class="value" x="#{@left - 6}" y="#{coordinate(y + 4)}">#{number(value)}</text>)
    ]
  end

  defp times(span, bottom) do
    seconds = div(span.to - span.from, 1_000_000)
    step = 1_000_000 * Enum.find(@steps, List.last(@steps), &(seconds / &1 <= 9))
    first = div(span.from + step - 1, step) * step

    for at <- first..span.to//step do
      x = coordinate(x(at, span))

      [
        ~s(<line class="grid" x1="#{x}" x2="#{x}" y1="#{@top}" y2="#{bottom + 3}"/>),
        ~s(<text class="time" x="#{x}" y="#{bottom + 14}">#{clock(at)}</text>)
      ]
    end
  end

  defp marks(rows, span, bottom) do
    for row <- marked(rows), row.kind != :note do
      x = coordinate(x(row.at, span))
      ~s(<line class="mark #{row.kind}" x1="#{x}" x2="#{x}" y1="#{@top}" y2="#{bottom}"/>)
    end
  end

  # Of too many rows some plain events have no mark, evenly over the whole time.
  defp marked(rows) do
    {events, others} = Enum.split_with(rows, &(&1.kind == :event))
    others = evenly(others, @max_marks)
    evenly(events, max(@max_marks - length(others), 50)) ++ others
  end

  defp evenly(rows, most), do: Enum.take_every(rows, max(ceil(length(rows) / most), 1))

  @doc "The ends of a scale for values between two, and its ticks: 1, 2 or 5 times a power of ten apart."
  @spec scale({number(), number()}) :: {float(), float(), [float()]}
  def scale({low, high}) do
    spread = max(high - low, max(abs(high) * 0.01, 0.1))
    power = :math.pow(10, Float.floor(:math.log10(spread / 4)))
    step = Enum.find([1, 2, 5, 10], 10, &(&1 * power * 4 >= spread)) * power
    {first, last} = {Float.floor(low / step), Float.ceil(high / step)}
    last = if last > first, do: last, else: first + 1
    {first * step, last * step, for(n <- 0..round(last - first), do: (first + n) * step)}
  end
end
