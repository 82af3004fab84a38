// Signs a command, sends it over NATS, and prints its progress and its result. docs/commands.md describes the signature.
//
//	go build -o command . && ./command URL SEED_FILE fleet.dev.sim-001.cmd.takeoff '{"params": {"altitude": 20}}'
//
// Transfers (docs/transfers.md) are asked for in the same way. Without an id in the body it makes one.
//
// Exit status: 0 completed or accepted, 1 any other result, or no answer. Then the same id may be asked for again.
package main

import (
	"bytes"
	"encoding/base64"
	"encoding/json"
	"fmt"
	"log"
	"os"
	"time"

	"github.com/nats-io/nats.go"
	"github.com/nats-io/nkeys"
	"github.com/nats-io/nuid"
)

func must[T any](value T, err error) T {
	if err != nil {
		log.Fatal(err)
	}
	return value
}

func main() {
	if len(os.Args) != 5 {
		log.Fatal("usage: command URL SEED_FILE SUBJECT BODY")
	}
	url, seed, subject := os.Args[1], must(os.ReadFile(os.Args[2])), os.Args[3]
	key := must(nkeys.FromSeed(bytes.TrimSpace(seed)))

	body := map[string]any{"id": nuid.Next()}
	must(0, json.Unmarshal([]byte(os.Args[4]), &body))
	message := nats.NewMsg(subject)
	message.Data = must(json.Marshal(body))
	at := time.Now().UTC().Format(time.RFC3339)
	text := fmt.Sprintf("aerie-command-1\n%s\n%s\n%s", subject, at, message.Data)
	signature := base64.RawURLEncoding.EncodeToString(must(key.Sign([]byte(text))))
	message.Header.Set("Aerie-Signature", must(key.PublicKey())+" "+at+" "+signature)

	// One channel for both, so that progress comes before the result.
	client, messages := must(nats.Connect(url)), make(chan *nats.Msg, 64)
	message.Reply = nats.NewInbox()
	must(client.ChanSubscribe(fmt.Sprint(subject, ".progress.", body["id"]), messages))
	must(client.ChanSubscribe(message.Reply, messages))
	must(0, client.PublishMsg(message))
	for {
		select {
		case m := <-messages:
			if m.Subject != message.Reply {
				fmt.Println("progress", string(m.Data))
				continue
			}
			if m.Header.Get("Status") == "503" {
				log.Fatal("no responders: no gateway hears this vehicle")
			}
			fmt.Println("result", string(m.Data))
			os.Exit(status(m.Data))
		case <-time.After(90 * time.Second):
			log.Fatal("no answer")
		}
	}
}

func status(reply []byte) int {
	var answer struct{ Result string }
	if json.Unmarshal(reply, &answer) == nil && (answer.Result == "completed" || answer.Result == "accepted") {
		return 0
	}
	return 1
}
