defmodule Aerie.Fleet.NatsTest do
  use Aerie.BridgeCase, async: true

  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.{JetStream, KV, Reader}
  alias Gnat.Jetstream.API.Stream

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} do
    conn = start_bridge(config(dir)) |> await_up() |> client()
    {:ok, _info} = Stream.create(conn, KV.stream("bucket", max_msgs_per_subject: 5, storage: :memory))
    %{conn: conn}
  end

  test "a key is changed only with its last revision, and made only if it has no value", %{conn: conn} do
    assert KV.get(conn, "bucket", "a.b") == {:none, 0}
    assert :ok = KV.put(conn, "bucket", "a.b", "one", expected: 0)
    assert :lost_race = KV.put(conn, "bucket", "a.b", "other", expected: 0)
    assert {:ok, "one", first} = KV.get(conn, "bucket", "a.b")
    assert :ok = KV.put(conn, "bucket", "a.b", ["t", "wo"], expected: first)
    assert :lost_race = KV.put(conn, "bucket", "a.b", "other", expected: first)
    assert :lost_race = KV.delete(conn, "bucket", "a.b", expected: first)
    assert {:ok, "two", second} = KV.get(conn, "bucket", "a.b")
    assert :ok = KV.delete(conn, "bucket", "a.b", expected: second)
    assert {:none, third} = KV.get(conn, "bucket", "a.b")
    assert third > second
    assert :ok = KV.put(conn, "bucket", "a.b", "anew", expected: third)
    assert {:ok, "anew", _revision} = KV.get(conn, "bucket", "a.b")
  end

  test "what is not there is an error that says so", %{conn: conn} do
    assert {:error, reason} = KV.get(conn, "none", "a")
    assert Nats.text(reason) == "stream not found"
    assert {:error, reason} = KV.watch(conn, "none", fn _key, _change -> :ok end)
    assert Nats.text(reason) == "stream not found"
    assert {:error, reason} = Reader.last(conn, "NONE", ">", & &1)
    assert Nats.text(reason) == "stream not found"
  end

  test "a watcher gets the last value of each key, then every change in order", %{conn: conn} do
    for value <- ~w(old new), do: :ok = KV.put(conn, "bucket", "a", value)
    :ok = KV.put(conn, "bucket", "b", "gone")
    :ok = KV.delete(conn, "bucket", "b")
    test = self()
    {:ok, watcher} = KV.watch(conn, "bucket", fn key, change -> send(test, {key, change}) end)
    assert_receive {"a", {:put, "new"}}
    assert_receive {"b", :removed}
    # More than one batch of a reader.
    for n <- 1..450, do: Nats.pub(conn, "$KV.bucket.c.#{n}", "#{n}")
    got = for _n <- 1..450, do: receive(do: ({"c." <> n, {:put, n}} -> String.to_integer(n)))
    assert got == Enum.to_list(1..450)
    refute_received {"a", _old}

    Process.flag(:trap_exit, true)
    :ok = Stream.delete(conn, "KV_bucket")
    assert_receive {:EXIT, ^watcher, {:shutdown, _why}}
  end

  test "a watcher ends with its connection", %{conn: conn} do
    Process.flag(:trap_exit, true)
    {:ok, watcher} = KV.watch(conn, "bucket", fn _key, _change -> :ok end)
    Process.exit(conn, :kill)
    assert_receive {:EXIT, ^watcher, {:shutdown, _why}}
  end

  test "the last messages are read once, however many there are, and nothing stays behind", %{conn: conn} do
    assert :ok = Reader.last(conn, "KV_bucket", "$KV.bucket.>", &send(self(), {:read, &1.body}))
    for n <- 1..450, do: Nats.pub(conn, "$KV.bucket.#{n}", "#{n}")
    :ok = KV.put(conn, "bucket", "1", "again")
    assert :ok = Reader.last(conn, "KV_bucket", "$KV.bucket.>", &send(self(), {:read, &1.body}))
    read = for _n <- 1..450, do: receive(do: ({:read, body} -> body))
    assert Enum.sort(read) == Enum.sort(["again" | Enum.map(2..450, &"#{&1}")])
    refute_received {:read, _more}
    assert {:ok, %{state: %{consumer_count: 0}}} = Stream.info(conn, "KV_bucket")
  end

  test "a stored message has its headers", %{conn: conn} do
    :ok = JetStream.publish(conn, "$KV.bucket.h", "body", headers: [{"Nats-Msg-Id", "id 1"}])
    assert {:ok, message} = JetStream.stored(conn, "KV_bucket", %{"last_by_subj" => "$KV.bucket.h"})
    assert message.body == "body"
    assert JetStream.header(message, "Nats-Msg-Id") == "id 1"
    assert JetStream.header(message, "Other") == nil
    assert JetStream.stored(conn, "KV_bucket", %{"last_by_subj" => "$KV.bucket.none"}) == :none
  end

  test "a message that the server would not take is not sent", %{conn: conn} do
    large = :binary.copy("x", 1_048_576)

    assert {:error, {:too_large, _bytes, 1_048_576} = reason} =
             Nats.pub(conn, "a", large, headers: [{"b", "c"}])

    assert Nats.text(reason) =~ "takes 1048576 at most"
    assert {:error, {:too_large, _bytes, _max}} = Nats.request(conn, "a", [large, "x"], receive_timeout: 1)
    assert {:ok, %{}} = JetStream.ask(conn, "$JS.API.INFO", "")
  end

  test "messages that are published together arrive each, and each has its result", %{conn: conn} do
    {:ok, _sid} = Nats.sub(conn, self(), "together.*")
    large = :binary.copy("x", 1_048_577)
    messages = for n <- 1..200, do: {"together.#{n}", if(n == 7, do: large, else: "#{n}")}
    results = Nats.pub_all(conn, messages)
    assert [{:error, {:too_large, 1_048_577, _max}}] = results |> Enum.at(6) |> List.wrap()
    assert List.delete_at(results, 6) == List.duplicate(:ok, 199)

    for n <- 1..200, n != 7 do
      {topic, body} = {"together.#{n}", "#{n}"}
      assert_receive {:msg, %{topic: ^topic, body: ^body}}
    end

    refute_received {:msg, _more}
    assert Nats.pub_all(conn, []) == []
  end

  test "without a connection nothing exits", %{conn: conn} do
    Process.unlink(conn)
    Process.exit(conn, :kill)

    for call <- [
          &Nats.pub(&1, "a", "b"),
          &List.last(Nats.pub_all(&1, [{"a", "b"}, {"c", "d"}])),
          &Nats.sub(&1, self(), "a"),
          &Nats.request(&1, "a", "b", receive_timeout: 1_000),
          &KV.get(&1, "bucket", "a"),
          &KV.put(&1, "bucket", "a", "b", expected: 0),
          &Reader.last(&1, "KV_bucket", ">", fn _message -> :ok end)
        ] do
      assert {:error, reason} = call.(conn)
      assert Nats.text(reason) =~ "connect"
    end
  end

  test "a request whose connection ends does not wait for its answer", %{conn: conn} do
    Process.unlink(conn)
    {:ok, _sid} = Nats.sub(conn, self(), "question")
    asker = Task.async(fn -> Nats.request(conn, "question", "", receive_timeout: 600_000) end)
    assert_receive {:msg, %{topic: "question"}}
    Process.exit(conn, :kill)
    assert {:error, reason} = Task.await(asker, :infinity)
    assert Nats.text(reason) == "the connection to NATS was lost"
  end

  test "reasons are texts" do
    for reason <- [
          :no_responders,
          :timeout,
          :econnrefused,
          {:too_large, 2, 1},
          %{"code" => 500, "description" => "x"},
          %RuntimeError{message: "closed"},
          {:shutdown, "closed"},
          {{:badmatch, {:error, :closed}}, [{:a, :b, 1, []}]},
          {:tls_alert, {:unknown_ca, ~c"TLS client: unknown\n ca"}},
          {:odd, 1}
        ] do
      assert Nats.text(reason) =~ ~r/\A[[:alnum:]][^%#\n]*\z/
    end
  end
end
