defmodule Phoenix.LiveView.ClientTest do
  @moduledoc "The unmodified client of npm in jsdom: what it makes of our diffs and of our server."
  use ExUnit.Case, async: true

  alias Phoenix.LiveView.{Comprehension, Diff, LiveStream, Rendered}
  alias Phoenix.LiveViewTest.{JavaScript, Trees}

  @moduletag :node
  @moduletag :tmp_dir
  @moduletag :capture_log

  @pages 26
  @changes 100
  @stream_changes 400

  test "the page after each of 3,000 random changes is the page that the server would render", %{
    tmp_dir: folder
  } do
    seed = ExUnit.configuration()[:seed]
    file = Path.join(folder, "trees.jsonl")
    trees = Enum.flat_map(1..@pages, &page(seed * 100_000 + &1 * 1_000))
    streams = streams(seed)
    assert length(trees) + length(streams) >= 3_000

    for lines <- [trees, streams] do
      File.write!(file, Enum.map_intersperse(lines, "\n", &JSON.encode_to_iodata!/1))
      {output, status} = JavaScript.run("trees.mjs", [file])
      assert status == 0, output
      assert output =~ "#{length(lines)} compared, 0 different"
    end
  end

  defp page(seed) do
    trees = for step <- 0..@changes, do: Trees.pick(Trees.tree(), 5 + rem(step, 30), seed + step)

    changes =
      trees
      |> Enum.chunk_every(2, 1, :discard)
      |> Enum.map(fn [a, b] -> %{diff: Diff.diff(a, b), html: html(b)} end)

    [whole(hd(trees)) | changes]
  end

  defp whole(tree), do: %{full: Diff.root(tree), html: html(tree)}
  defp html(tree), do: tree |> Diff.to_iodata() |> IO.iodata_to_binary()

  # A list of rows beside what the client is told of it.
  defp streams(seed) do
    :rand.seed(:exsss, {seed, 1, 2})
    stream = LiveStream.new(:rows, "0")
    first = render(stream, 0)
    start = {LiveStream.prune(stream), [], Diff.sent(first)}

    {changes, _state} =
      Enum.map_reduce(1..@stream_changes, start, fn n, {stream, rows, sent} ->
        # Greatest first: the client deletes before it inserts, whatever the order of the calls.
        steps = 1..:rand.uniform(3) |> Enum.map(fn _ -> :rand.uniform(20) end) |> Enum.sort(:desc)
        {stream, rows} = Enum.reduce(steps, {stream, rows}, &step(&1, n, &2))

        tree = render(stream, n)

        change = %{
          diff: Diff.diff(sent, tree),
          html: "<u>#{n}</u><ul id=\"rows\" phx-update=\"stream\">#{markup(rows)}</ul>"
        }

        {change, {LiveStream.prune(stream), rows, Diff.sent(tree)}}
      end)

    [%{full: Diff.root(first), html: "<u>0</u><ul id=\"rows\" phx-update=\"stream\"></ul>"} | changes]
  end

  defp step(20, _n, {stream, _rows}), do: {LiveStream.reset(stream), []}

  defp step(choice, _n, {stream, rows}) when choice > 14 do
    id = "rows-#{:rand.uniform(12)}"
    {LiveStream.delete(stream, id), List.keydelete(rows, id, 0)}
  end

  defp step(_insert, n, {stream, rows}) do
    id = :rand.uniform(12)
    name = "rows-#{id}"
    at = Enum.random([-1, 0, 1])
    item = %{id: id, text: "#{n}"}

    # A row that is told of twice in one rendering, or deleted in it, would have no defined place.
    cond do
      List.keymember?(stream.inserts, name, 0) or name in stream.deletes ->
        {stream, rows}

      List.keymember?(rows, name, 0) ->
        {LiveStream.insert(stream, item, []), List.keyreplace(rows, name, 0, {name, item.text})}

      true ->
        {LiveStream.insert(stream, item, at: at), List.insert_at(rows, at, {name, item.text})}
    end
  end

  defp render(stream, n) do
    entries = for {id, item} <- stream, do: {:index, [id, item.text]}
    rows = Comprehension.new(["<li id=\"", "\">", "</li>"], entries, LiveStream.wire(stream))
    static = ["<u>", "</u><ul id=\"rows\" phx-update=\"stream\">", "</ul>"]
    %Rendered{static: static, dynamic: ["#{n}", rows]}
  end

  defp markup(rows), do: Enum.map_join(rows, fn {id, text} -> ~s(<li id="#{id}">#{text}</li>) end)

  test "flows with the running server: joins, events, forms, navigation, crashes, refusals" do
    site = Phoenix.LiveViewTest.Site.start()
    {output, status} = JavaScript.run("flows.mjs", [site.url])
    assert status == 0, output
  end

  @tag :chromium
  test "flows in Chromium" do
    site = Phoenix.LiveViewTest.Site.start(routes: JavaScript.routes())
    {output, status} = JavaScript.run("chromium.mjs", [site.url])
    assert status == 0, output
  end
end
