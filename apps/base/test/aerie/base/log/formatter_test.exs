defmodule Aerie.Base.Log.FormatterTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Log.Formatter

  @time 1_795_213_318_123_456

  defp format(message, meta \\ %{}, format \\ :logfmt) do
    {Formatter, config} = Formatter.new(format)
    event = %{level: :warning, msg: {:string, message}, meta: Map.merge(%{time: @time, pid: self()}, meta)}
    event |> Formatter.format(config) |> IO.iodata_to_binary()
  end

  test "a line has the whole time, the level, the message, the subject and further pairs" do
    meta = %{
      vehicle: "VID-001",
      link: "radio1",
      gateway: ":default",
      fields: [peers: 2, position: %{lat: 1.5}],
      file: ~c"x.ex"
    }

    assert format("it is down", meta) ==
             ~s(time=2026-11-20T22:21:58.123Z level=warning msg="it is down" link=radio1 vehicle=VID-001 peers=2 position.lat=1.5\n)

    assert format("up") == "time=2026-11-20T22:21:58.123Z level=warning msg=up\n"
  end

  test "JSON has the same keys, numbers as numbers" do
    line = format("it is \"down\"\n", %{link: "radio1", fields: [peers: 2]}, :json)
    assert [line, ""] = String.split(line, "\n")

    assert JSON.decode!(line) == %{
             "time" => "2026-11-20T22:21:58.123Z",
             "level" => "warning",
             "msg" => "it is \"down\"\n",
             "link" => "radio1",
             "peers" => 2
           }
  end

  test "what comes from outside cannot forge a line, steer a terminal, or make a line longer than its bound" do
    line = format("a\nlevel=error msg=forged \e[2J \x00", %{vehicle: "V\" level=error"})
    assert [line, ""] = String.split(line, "\n")
    assert line =~ ~S(msg="a\nlevel=error msg=forged \u001b[2J \u0000" vehicle="V\" level=error")
    assert format(<<"a", 0xFF, "b">>) =~ "msg=a\uFFFDb"
    assert byte_size(format(String.duplicate("é", 100_000))) < 10_000
    fields = for n <- 1..1000, do: {"k#{n}", String.duplicate("x", 10_000)}
    assert byte_size(format("m", %{fields: fields})) < 60_000
  end

  test "an event that cannot be formatted is a line nevertheless" do
    assert format("m", %{fields: [{self(), 1}]}) =~ "unprintable"
    assert {:error, _reason} = Formatter.check_config(%{format: :xml})
  end

  test "a process's label gives the subject of what it does not say itself" do
    told =
      fn label ->
        Task.async(fn ->
          Process.set_label(label)
          format("m")
        end)
        |> Task.await(:infinity)
      end

    assert told.({:session, "VID-001"}) =~ " vehicle=VID-001"
    assert told.({:vehicle, "VID-001", {"main", 1}}) =~ " vehicle=VID-001"
    assert told.({:link_tree, "radio1"}) =~ " link=radio1"
    refute told.({:router, :default}) =~ "router"
  end

  for {name, text} <- [
        url: "cannot reach nats://user:SENTINEL@host:4222",
        token_in_url: "cannot reach nats://SENTINEL@host:4222",
        header: ~s(%{"x-aerie-key" => "SENTINEL", "host" => "h"}),
        erlang_header: ~s(#{"\#"}{<<"x-aerie-key">> => <<"SENTINEL">>}),
        bearer: ~s(authorization: Bearer SENTINEL),
        pair: ~s({<<"authorization">>,<<"Bearer SENTINEL">>}),
        keyword: ~s(password: "SENTINEL", port: 1),
        setting: "api_key=SENTINEL",
        cookie: "Cookie: aerie_ab12=SENTINEL; theme=dark",
        ticket: "/?ticket=SENTINEL&network=main",
        protocol: "mavlink, ticket.SENTINEL"
      ] do
    test "no secret is written: #{name}" do
      line = format(unquote(text))
      refute line =~ "SENTINEL"
      assert line =~ "[hidden]"
    end
  end

  test "words that only sound like secrets stay" do
    for text <- ["the key is unknown", "udpin:0.0.0.0:14550", "the token is missing", "see https://host/a@b"],
        do: assert(format(text) =~ text)
  end
end
